"""The tree of `CAMPAIGN.toml`: many recordings that are estimated as one, and where their results go."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from midspan.errors import UsageError
from midspan.fusion.methods import METHODS
from midspan.settings.fields import FileName, Form, Name, OneOf, Section
from midspan.settings.load import validate
from midspan.trees import TreeError, read_toml
from midspan.vision.tracker import TRACKERS

CAMPAIGN_FILE = "CAMPAIGN.toml"


class CampaignSettings(Section):
    """The recordings of a campaign, and what all of them are estimated with."""

    recordings: Annotated[tuple[FileName, ...], Form("texts")] = Field(
        (), description="globs, folders or URLs of recordings, relative to this file"
    )
    table: FileName | None = Field(
        None,
        description="CSV or Parquet with columns accelerometer, video and any option of estimate",
    )
    output: FileName = Field(description="folder of the results, relative to this file")
    method: Name | None = Field(None, description="method of all; default: each recording's own")
    tracker: Name | None = Field(None, description="tracker of all; default: each recording's own")
    calibration: FileName | None = Field(None, description="calibration of all; default: each its own")

    @model_validator(mode="after")
    def _names_recordings(self) -> "CampaignSettings":
        if not self.recordings and self.table is None:
            raise ValueError("must name recordings or a table")
        for name, table, kind in ((self.method, METHODS, "method"), (self.tracker, TRACKERS, "tracker")):
            if name is not None:
                OneOf(table, kind)(name)
        return self


def load_campaign(path: str | Path) -> tuple[CampaignSettings, Path]:
    """The settings of a campaign (its file or folder) and the file, to whose folder its paths are relative."""
    path = Path(path)
    file = path / CAMPAIGN_FILE if path.is_dir() else path
    try:
        tree = read_toml(file)
    except TreeError as error:
        raise UsageError(f"{file}: {error}.") from None
    except OSError as error:
        raise UsageError(f"{file}: cannot be read ({error.strerror}). A campaign is a {CAMPAIGN_FILE}.") from None
    return validate(tree, str(file), CampaignSettings), file
