"""`midspan replay RECORDING`."""

import shutil
from pathlib import Path
from typing import Any

import click

from midspan.cli.console import Console, common_options
from midspan.papers.published import PAPER_KEYS


@click.command("replay")
@click.argument("recording", type=click.Path())
@click.option("-o", "--output", "store", required=True, help="Store: a folder or postgresql://…; created if missing.")
@click.option("--point", help="Name of the point. Default: the recording's name.")
@click.option(
    "--speed",
    type=click.FloatRange(0.0, 1e6, min_open=True),
    help="Speed relative to real time. Default: as fast as possible.",
)
@click.option(
    "-c",
    "--calibration",
    "calibration_file",
    type=click.Path(),
    help="Calibration to use. Default: calibrate this recording.",
)
@click.option("--method", help="Method other than smoother.  [default: kalman]")
@click.option("--literal", is_flag=True, help="Method, calibration and tracker as printed in the papers.")
@click.option("--paper", type=click.Choice(PAPER_KEYS), help="Tracker, calibration, method and keys of one paper.")
@click.option(
    "--for", "length_s", type=click.FloatRange(0.0, min_open=True), help="Stop after this many s of the recording."
)
@common_options
def command(recording: str, store: str, quiet: bool, as_json: bool, **options: Any) -> None:
    """Replay a recording through a live point into a store; the rows equal those of `estimate` with the same method."""
    console = Console(quiet, as_json)
    from midspan.checks import option
    from midspan.cli.estimate import open_with
    from midspan.cli.targets import check_store
    from midspan.service.replay import LIVE, point_called, replay
    from midspan.settings.stored.calibration import load_calibration
    from midspan.store.store import open_store

    method = None if options["paper"] else option("method", options["method"] or "kalman", LIVE)
    opened = open_with(recording, None, options["method"] or method, options["literal"], paper=options["paper"])
    method = method or opened.settings.fusion.method
    calibration = load_calibration(options["calibration_file"]) if options["calibration_file"] else None
    name = point_called(options["point"], opened)
    check_store(store)
    is_new = "://" not in store and not Path(store).exists()
    kept = open_store(store, points=[name])
    try:
        done = replay(
            opened,
            kept,
            name=name,
            calibration=calibration,
            method=method,
            speed=options["speed"],
            length_s=options["length_s"],
            progress=console.progress,
        )
    except BaseException:
        kept.close()
        if is_new:
            shutil.rmtree(store, ignore_errors=True)
        raise
    kept.close()
    console.done()
    console.table([("point", name), ("rows", f"{done.rows} of {done.length_s:.1f} s"), ("store", store)])
    late = {"sample": done.from_sample, "frame": done.from_frame}
    console.table(
        [
            (f"{what} to row", f"{1e3 * one.median_s:.3g} ms (median), {1e3 * one.of_95_s:.3g} ms (95 %)")
            for what, one in late.items()
            if one is not None
        ]
    )
    console.warn(done.warnings)
    document = {"point": name, "rows": done.rows, "length_s": done.length_s, "store": store}
    for what, one in late.items():
        if one is not None:
            document[f"{what}_to_row_s"] = {"median": one.median_s, "of_95": one.of_95_s}
    console.document({**document, "warnings": list(done.warnings)})
