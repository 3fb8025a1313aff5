"""`midspan track SOURCE`."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, RegionType, common_options
from midspan.notices import notice_trees

if TYPE_CHECKING:
    from midspan.recording.tracking.track import Tracked


@click.command("track")
@click.argument("source", type=click.Path())
@click.option(
    "--roi", type=RegionType(), help="Region of interest, px. Default: the recording's, else selected automatically."
)
@click.option("--tracker", help="Tracker; see `midspan methods`.")
@click.option("--every", type=click.IntRange(min=1), help="Use every n-th frame.")
@click.option("--rate-hz", type=float, help="Frame rate, Hz, if the file has no time stamps.")
@click.option("--start-s", type=float, default=0.0, help="Time of the first frame, s.")
@click.option("-o", "--output", required=True, type=click.Path(), help="Table to write; the suffix selects the format.")
@common_options
def command(source: str, output: str, quiet: bool, as_json: bool, **options: Any) -> None:
    """Translation of a target in pixels (x right, y down) for each frame: camera alone, no accelerometer needed.

    SOURCE is a recording, a video, a folder or glob of images, or an .npy/.npz stack.
    """
    from midspan.checks import RATE_HZ, option, within
    from midspan.cli.targets import check_result
    from midspan.recording.streams.recording import open_recording
    from midspan.recording.tracking.track import track
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
            raise click.UsageError("--rate-hz and --start-s: for a recording set these keys in [camera].")
    else:
        check_result(output)
    if options["rate_hz"] is not None:
        within("--rate-hz", options["rate_hz"], RATE_HZ)
    if options["tracker"] is not None:
        option("--tracker", options["tracker"], TRACKERS)
    tracked = track(source, **options, progress=console.progress)
    console.done()
    tracked.save(output)
    figures = _figures(tracked, output)
    regions = figures.get("targets") or {"": figures["roi"]}
    console.table(
        [
            ("frames", f"{figures['frames']}, {figures['lost']} lost"),
            *(
                (f"target {name}" if name else "roi", f"x {x}, y {y}, {width} × {height} px")
                for name, (x, y, width, height) in regions.items()
            ),
            *((axis, _along(figures, axis)) for axis in "xy"),
            ("written", output),
        ]
    )
    console.warn(tracked.warnings)
    console.document(figures)


def _figures(tracked: "Tracked", output: str) -> dict[str, Any]:
    """The document: counts, regions, and along each axis the translation's range and typical standard deviation."""
    import numpy as np

    from midspan.records import Region, Status

    rows, count, keys = tracked.track, len(tracked.track.time_ns), Region.__slots__
    lost = int(np.count_nonzero(rows.status == Status.LOST))
    figures: dict[str, Any] = {"frames": count, "lost": lost, "roi": [getattr(tracked.region, key) for key in keys]}
    if len(tracked.tracking.targets) > 1:
        targets = tracked.tracking.targets
        figures["targets"] = {one.name: [getattr(one.region, key) for key in keys] for one in targets}
    for axis in "xy":
        value, variance = rows.along(axis)
        ends = [round(float(end(value)), 4) for end in (np.nanmin, np.nanmax)] if np.isfinite(value).any() else None
        figures[f"range_{axis}_px"] = ends
        figures[f"median_std_{axis}_px"] = float(np.nanmedian(np.sqrt(variance))) if lost < count else None
    notices = {"warnings": list(tracked.warnings), "notices": notice_trees(tracked.warnings)}
    return {**figures, "written": output, **notices}


def _along(figures: dict[str, Any], axis: str) -> str:
    """The range of the translation along an image axis, and its typical standard deviation."""
    found, std = figures[f"range_{axis}_px"], figures[f"median_std_{axis}_px"]
    if found is None or std is None:
        return "not measured"
    return f"{found[0]:.4g} … {found[1]:.4g} px, standard deviation {std:.3g} px (median)"
