"""`midspan demo`: the whole chain on a recording that it makes itself."""

from pathlib import Path

import click

from midspan.cli.console import Console, common_options

SCENARIO = "footbridge"


@click.command("demo")
@click.option("-o", "--output", type=click.Path(), default="midspan-demo", show_default=True, help="Folder to write.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the random motion and noise."
)
@common_options
def command(output: str, seed: int, quiet: bool, as_json: bool) -> None:
    """A complete run: simulate, inspect, calibrate, estimate, compare with the truth, report. Under a minute."""
    from midspan.cli import compare, estimate, inspect
    from midspan.cli.calibrate import describe
    from midspan.cli.targets import check_result
    from midspan.evaluate.bound import least_error_mm
    from midspan.evaluate.result_file import compare as compare_results
    from midspan.recording.calibrate import calibrate_and_track
    from midspan.recording.estimate import estimate as run_estimate
    from midspan.recording.inspect import inspect_recording
    from midspan.recording.streams.recording import open_recording
    from midspan.simulate.scenarios.table import NAMES
    from midspan.simulate.scenarios.write import write

    console = Console(quiet, as_json)
    folder = Path(output)
    place = folder / "recording"
    for name in ("result.csv", "report.html"):
        check_result(folder / name)
    console.say(f"1. simulate: {NAMES[SCENARIO]}")
    write(SCENARIO, place, seed=seed, progress=lambda done, total: console.progress(done, total, "rendering"))
    console.done()
    console.say(f"   written to {place}\n\n2. inspect")
    recording = open_recording(place)
    inspect.show(console, inspect_recording(recording, progress=console.progress))
    console.say("\n3. calibrate: scale factor, clock offset and noise are unknown")
    calibration, tracking = calibrate_and_track(recording, console.progress)
    console.done()
    calibration.save(place)
    describe(console, calibration)
    console.say("\n4. estimate")
    result = run_estimate(recording, calibration, tracking=tracking, progress=console.progress)
    result.save(folder / "result.csv")
    estimate.write_report(result, folder / "report.html", (recording.reference, None), console)
    estimate.show(Console(quiet or as_json, False), result, [str(folder / "result.csv"), str(folder / "report.html")])
    console.say("\n5. compare with the truth")
    figures = compare_results(folder / "result.csv", place / "truth.csv").to_dict()
    compare.show(console, figures)
    bound = least_error_mm(result)
    ratio = figures["rmse_mm"] / bound
    console.say(f"\nError {figures['rmse_mm']:.4f} mm rms: {ratio:.2f} times the lower bound from sensor noise")
    console.say(f"({bound:.4f} mm). Open {folder / 'report.html'}.")
    console.document({**figures, "bound_mm": bound, "ratio_to_bound": ratio, "folder": str(folder)})
