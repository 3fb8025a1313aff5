"""`midspan demo`: the whole chain on a recording that it makes itself."""

import json
from pathlib import Path
from typing import Any

import click

from midspan.cli.console import Console, common_options

SCENARIO = "footbridge"


@click.command("demo")
@click.option("-o", "--output", type=click.Path(), default="midspan-demo", show_default=True, help="Folder to write.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Another seed, another minute.")
@common_options
def command(output: str, seed: int, quiet: bool, as_json: bool) -> None:
    """A complete run: simulate, inspect, calibrate, estimate, compare with the truth, report. Under a minute."""
    from midspan.cli import compare, estimate, inspect
    from midspan.cli.calibrate import describe
    from midspan.evaluate.result_file import compare_files
    from midspan.recording.calibrate import calibrate_and_track
    from midspan.recording.estimate import estimate as run_estimate
    from midspan.recording.inspect import inspect_recording
    from midspan.recording.recording import open_recording
    from midspan.simulate.scenarios import NAMES, write

    console = Console(quiet, as_json)
    folder = Path(output)
    place = folder / "recording"
    console.say(f"1. simulate: {NAMES[SCENARIO]}")
    write(SCENARIO, place, seed=seed, progress=lambda done, total: console.progress(done, total, "rendering"))
    console.done()
    console.say(f"   written to {place}\n\n2. inspect")
    recording = open_recording(place)
    inspect.show(console, inspect_recording(recording, progress=console.progress))
    console.say("\n3. calibrate: nothing was measured beforehand, the clocks differ, the target's size is unknown")
    calibration, tracking = calibrate_and_track(recording, console.progress)
    console.done()
    calibration.save(place)
    describe(console, calibration.to_dict())
    console.say("\n4. estimate")
    result = run_estimate(recording, calibration, tracking=tracking, progress=console.progress)
    result.save(folder / "result.csv")
    estimate.write_report(result, folder / "report.html", recording.reference, console)
    estimate.show(Console(quiet or as_json, False), result, [str(folder / "result.csv"), str(folder / "report.html")])
    console.say("\n5. compare with the truth")
    figures = compare_files(folder / "result.csv", place / "truth.csv").to_dict()
    compare.show(console, figures)
    bound = bound_mm(place, recording, result, seed)
    ratio = figures["rmse_mm"] / bound
    console.say(f"\nError {figures['rmse_mm']:.4f} mm rms: {ratio:.2f} times the least that the sensors' noise allows")
    console.say(f"({bound:.4f} mm). Look at {folder / 'report.html'}.")
    console.document({**figures, "bound_mm": bound, "ratio_to_bound": ratio, "folder": str(folder)})


def bound_mm(place: Path, recording: Any, result: Any, seed: int) -> float:
    """The least rms error (mm) for the noise that was put in: Cramér-Rao bound of the region, known sensors."""
    import numpy as np

    from midspan.evaluate.bound import zeroed_bound
    from midspan.records import Acceleration, Displacement, Source
    from midspan.simulate.scenarios import pixel_bound

    known = json.loads((place / "known.json").read_text(encoding="utf-8"))
    _, pixel_std = pixel_bound(SCENARIO, result.calibration.camera.region, seed=seed)
    std_m = pixel_std * abs(known["camera"]["scale_mm_per_px"]) / 1e3
    camera_ns = result.track.time_ns + round(1e9 * known["camera"]["time_offset_s"])
    prepared = recording.prepared
    density = known["accelerometer"]["noise_std_m_s2"] ** 2 / prepared.rate_hz
    n, m = len(prepared.time_ns), len(camera_ns)
    acceleration = Acceleration(prepared.time_ns, np.zeros(n), np.full(n, density))
    source = np.full(m, Source.CAMERA, dtype=np.uint8)
    return 1e3 * zeroed_bound(acceleration, Displacement(camera_ns, np.zeros(m), np.full(m, std_m**2), source))
