"""`midspan replay RECORDING`."""

from typing import Any

import click

from midspan.cli.console import Console, common_options


@click.command("replay")
@click.argument("recording", type=click.Path())
@click.option("-o", "--output", "store", required=True, help="Store: a folder, or postgresql://…; made where missing.")
@click.option("--point", help="Name of the point; left out: the recording's name.")
@click.option("--speed", type=click.FloatRange(0.0, 1e6, min_open=True), help="Times real time; left out: no waiting.")
@click.option("-c", "--calibration", "calibration_file", type=click.Path(), help="Calibration; left out: calibrate.")
@click.option("--method", default="kalman", show_default=True, help="kalman, lag or adaptive-kalman.")
@common_options
def command(recording: str, store: str, quiet: bool, as_json: bool, **options: Any) -> None:
    """Play a recording through a live point into a store: the rows are those of `estimate --method kalman`."""
    console = Console(quiet, as_json)
    from midspan.checks import option
    from midspan.cli.targets import check_store
    from midspan.recording.streams.recording import open_recording
    from midspan.service.replay import LIVE, point_called, replay
    from midspan.settings.stored.calibration import load_calibration
    from midspan.store.store import open_store

    option("method", options["method"], LIVE)
    opened = open_recording(recording)
    calibration = load_calibration(options["calibration_file"]) if options["calibration_file"] else None
    name = point_called(options["point"], opened)
    check_store(store)
    kept = open_store(store, points=[name])
    try:
        done = replay(
            opened,
            kept,
            name=name,
            calibration=calibration,
            method=options["method"],
            speed=options["speed"],
            progress=console.progress,
        )
    finally:
        kept.close()
    console.done()
    console.table([("point", name), ("rows", f"{done.rows} of {done.length_s:.1f} s"), ("store", store)])
    console.warn(done.warnings)
    document = {"point": name, "rows": done.rows, "length_s": done.length_s, "store": store}
    console.document({**document, "warnings": list(done.warnings)})
