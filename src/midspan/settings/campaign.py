"""The tree of `CAMPAIGN.toml`: many recordings that are estimated as one, and where their results go."""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from midspan.errors import UsageError
from midspan.fusion.methods import METHODS
from midspan.settings.fields import FileName, Form, Section, known
from midspan.settings.load import RECORDING_FILE, validate
from midspan.trees import TreeError, read_toml
from midspan.vision.tracker import TRACKERS

CAMPAIGN_FILE = "CAMPAIGN.toml"
NO_URL = "a folder of this machine, not a URL"


def _is_a_folder(value: str) -> str:
    if "://" in value:
        raise ValueError(f"must be {NO_URL}. Copy the results from it afterwards")
    return value


class CampaignSettings(Section):
    """The recordings of a campaign, and what all of them are estimated with."""

    recordings: Annotated[tuple[FileName, ...], Form("texts")] = Field(
        (), description="globs, folders or URLs of recordings, relative to this file"
    )
    table: FileName | None = Field(
        None,
        description="CSV or Parquet with columns accelerometer, video and any option of estimate",
    )
    output: Annotated[FileName, AfterValidator(_is_a_folder)] = Field(
        description="folder of the results, relative to this file"
    )
    method: Annotated[str | None, known(METHODS, "method")] = Field(
        None, description="method of all; default: each recording's own"
    )
    tracker: Annotated[str | None, known(TRACKERS, "tracker")] = Field(
        None, description="tracker of all; default: each recording's own"
    )
    calibration: FileName | None = Field(None, description="calibration of all; default: each its own")

    @model_validator(mode="after")
    def _names_recordings(self) -> "CampaignSettings":
        if not self.recordings and self.table is None:
            raise ValueError("must name recordings or a table")
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


def is_campaign(path: str | Path) -> bool:
    """Whether a file is a CAMPAIGN.toml, by its name or by keys that only such a file has, or a folder with one."""
    file = Path(path)
    try:
        if file.is_dir():
            return (file / CAMPAIGN_FILE).is_file() and not (file / RECORDING_FILE).exists()
        return file.name == CAMPAIGN_FILE or not read_toml(file).keys().isdisjoint(("recordings", "table"))
    except (TreeError, OSError, ValueError):
        return False
