"""`midspan track SOURCE`."""

from pathlib import Path
from typing import Any

import click

from midspan.cli.console import Console, RegionType, common_options
from midspan.notices import notice_trees


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
    from midspan.records import Region, Status
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
    rows, count = tracked.track, len(tracked.track.time_ns)
    lost = int(np.count_nonzero(rows.status == Status.LOST))
    regions = {one.name: [getattr(one.region, key) for key in Region.__slots__] for one in tracked.tracking.targets}
    several = len(regions) > 1
    figures = {
        "frames": count,
        "lost": lost,
        "roi": [getattr(tracked.region, key) for key in Region.__slots__],
        **({"targets": regions} if several else {}),
        **{f"range_{axis}_px": _range(rows.along(axis)[0]) for axis in "xy"},
        **{
            f"median_std_{axis}_px": float(np.nanmedian(np.sqrt(rows.along(axis)[1]))) if lost < count else None
            for axis in "xy"
        },
        "written": output,
        "warnings": list(tracked.warnings),
        "notices": notice_trees(tracked.warnings),
    }
    console.table(
        [
            ("frames", f"{count}, {lost} lost"),
            *(
                (f"target {name}" if several else "roi", f"x {x}, y {y}, {width} × {height} px")
                for name, (x, y, width, height) in regions.items()
            ),
            *((axis, _along(figures, axis)) for axis in "xy"),
            ("written", output),
        ]
    )
    console.warn(tracked.warnings)
    console.document(figures)


def _range(values: Any) -> list[float] | None:
    import numpy as np

    ends = (np.nanmin, np.nanmax)
    return [round(float(end(values)), 4) for end in ends] if np.isfinite(values).any() else None


def _along(figures: dict[str, Any], axis: str) -> str:
    """The range of the translation along an image axis, and its typical standard deviation."""
    found, std = figures[f"range_{axis}_px"], figures[f"median_std_{axis}_px"]
    if found is None or std is None:
        return "not measured"
    return f"{found[0]:.4g} … {found[1]:.4g} px, standard deviation {std:.3g} px (median)"
