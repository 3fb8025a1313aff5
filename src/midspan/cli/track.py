"""`midspan track SOURCE`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, RegionType, common_options
from midspan.notices import notice_trees

if TYPE_CHECKING:
    from midspan.recording.tracking.track import Tracked
    from midspan.records import Region


@click.command("track")
@click.argument("source", type=click.Path())
@click.option("--roi", type=RegionType(), help="Region of interest in px; left out: the recording's, else chosen.")
@click.option("--tracker", help="See `midspan methods`.")
@click.option("--every", type=click.IntRange(min=1), help="Use every n-th frame.")
@click.option("--rate-hz", type=float, help="Frames a second, where the source has no time stamps.")
@click.option("--start-s", type=float, default=0.0, help="Time of the first frame, s.")
@click.option(
    "-o", "--output", required=True, type=click.Path(), help="File to write (.csv .parquet .h5 .mat .xlsx .tdms)."
)
@common_options
def command(source: str, output: str, quiet: bool, as_json: bool, **options: Any) -> None:
    """Translation of a target in pixels (x right, y down) for each frame: camera alone, no accelerometer needed.

    SOURCE is a recording, a video, a folder or glob of images, or an .npy/.npz stack.
    """
    import numpy as np

    from midspan.checks import RATE_HZ, option, within
    from midspan.cli.targets import check_result
    from midspan.recording.streams.recording import open_recording
    from midspan.recording.tracking.track import track
    from midspan.records import Status
    from midspan.settings.load import RECORDING_FILE
    from midspan.sinks.write import check_target
    from midspan.vision.tracker import TRACKERS

    console = Console(quiet, as_json)
    check_target(Path(output))
    if Path(output).suffix.lower() in (".mseed", ".uff"):
        raise click.UsageError(f"-o {output}: a track is written as .csv, .parquet, .h5, .mat, .xlsx or .tdms.")
    if Path(source).name == RECORDING_FILE or (Path(source) / RECORDING_FILE).is_file():
        check_result(output, open_recording(source))
        if options["rate_hz"] is not None or options["start_s"]:
            raise click.UsageError("--rate-hz and --start-s: a recording says these itself, in [camera].")
    else:
        check_result(output)
    if options["rate_hz"] is not None:
        within("--rate-hz", options["rate_hz"], RATE_HZ)
    if options["tracker"] is not None:
        option("--tracker", options["tracker"], TRACKERS)
    tracked = track(source, **options, progress=console.progress)
    console.done()
    tracked.save(output)
    rows, region = tracked.track, tracked.region
    lost = int(np.count_nonzero(rows.status == Status.LOST))
    figures = {
        "frames": len(rows.time_ns),
        "lost": lost,
        "roi": [region.x, region.y, region.width, region.height],
        **_others(tracked),
        "range_x_px": _range(rows.x_px),
        "range_y_px": _range(rows.y_px),
        "median_std_x_px": float(np.nanmedian(np.sqrt(rows.variance_x_px2))) if lost < len(rows.time_ns) else None,
        "median_std_y_px": float(np.nanmedian(np.sqrt(rows.variance_y_px2))) if lost < len(rows.time_ns) else None,
        "written": output,
        "warnings": list(tracked.warnings),
        "notices": notice_trees(tracked.warnings),
    }
    console.table(_rows(figures, tracked))
    console.warn(tracked.warnings)
    console.document(figures)


def _others(tracked: "Tracked") -> dict[str, Any]:
    """Regions by name, where there are several targets."""
    targets = tracked.tracking.targets
    if len(targets) == 1:
        return {}
    regions = {t.name: [t.region.x, t.region.y, t.region.width, t.region.height] for t in targets}
    return {"targets": regions}


def _rows(figures: dict[str, Any], tracked: "Tracked") -> list[tuple[str, str]]:
    """The figures for a person."""
    several = len(tracked.tracking.targets) > 1
    return [
        ("frames", f"{figures['frames']}, {figures['lost']} lost"),
        *((f"target {one.name}" if several else "roi", _place(one.region)) for one in tracked.tracking.targets),
        *((axis, _along(figures, axis)) for axis in "xy"),
        ("written", figures["written"]),
    ]


def _place(region: "Region") -> str:
    return f"x {region.x}, y {region.y}, {region.width} × {region.height} px"


def _along(figures: dict[str, Any], axis: str) -> str:
    """The range of the translation along an image axis, and its typical standard deviation."""
    found, std = figures[f"range_{axis}_px"], figures[f"median_std_{axis}_px"]
    if found is None or std is None:
        return "not measured"
    return f"{found[0]:.4g} … {found[1]:.4g} px, standard deviation {std:.3g} px (median)"


def _range(values: Any) -> list[float] | None:
    import numpy as np

    return (
        [round(float(np.nanmin(values)), 4), round(float(np.nanmax(values)), 4)] if np.isfinite(values).any() else None
    )
