"""`midspan calibrate RECORDING`."""

import math
from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, common_options

if TYPE_CHECKING:
    from midspan.calibration.sensors.camera import TargetCalibration
    from midspan.calibration.sensors.radar import RadarTarget
    from midspan.settings.stored.calibration import Calibration


@click.command("calibrate")
@click.argument("recording", type=click.Path())
@click.option("-o", "--output", type=click.Path(), help="File to write; left out: calibration.json in the recording.")
@click.option("--tracker", help="Tracker, over the recording's own; see `midspan methods`.")
@click.option("--literal", is_flag=True, help="Scale factor and clock offset of a camera as the papers print them.")
@common_options
def command(recording: str, output: str | None, tracker: str | None, literal: bool, quiet: bool, as_json: bool) -> None:
    """Find scale factor, clock offset and noise levels, and write them to calibration.json."""
    console = Console(quiet, as_json)
    from midspan.cli.estimate import open_with
    from midspan.cli.targets import check_calibration
    from midspan.recording.calibrate import calibrate

    opened = open_with(recording, tracker, literal=literal, fused=False)
    console.progress(0, 1, "reading the recording")
    target = check_calibration(output, opened) if output else opened.folder
    calibration = calibrate(opened, console.progress)
    console.done()
    file = calibration.save(target)
    describe(console, calibration)
    console.warn(calibration.warnings)
    console.say(f"written to {file}")
    console.document({**calibration.to_dict(), "file": str(file)})


def describe(console: Console, calibration: "Calibration") -> None:
    """Print a calibration's values with their standard deviations, as the report has them, and its targets."""
    from midspan.calibration.sensors.camera import CameraCalibration
    from midspan.calibration.sensors.radar import RadarCalibration
    from midspan.report.tables import calibrated, radar_place

    rows = [(label.replace(": ", " "), value) for label, value in calibrated(calibration)]
    for name, _, sensor in calibration.sensors:
        if isinstance(sensor, RadarCalibration):
            rows += [(f"{name} target {radar_place(one.target)}", _radar_target(one)) for one in sensor.targets]
        elif isinstance(sensor, CameraCalibration) and len(sensor.targets) > 1:
            rows += [(f"{name} target {one.name}", _target(one)) for one in sensor.targets]
    camera = None if calibration.across is None else calibration.across.first_camera
    if camera is not None:
        how = "with its own acceleration" if camera.fused else "tracked only"
        value = f"{1e3 * camera.scale.value_m_per_px:.5g} mm/px, {how}"
        rows.append((f"scale factor along {camera.direction}", value))
    console.table(rows)


def _radar_target(item: "RadarTarget") -> str:
    """Level, factor and coherence of a radar's target, and whether the result rests on it."""
    target = item.target
    found = [f"{target.snr_db:.0f} dB"] if math.isfinite(target.snr_db) else []
    if math.isfinite(target.conversion_factor) and math.isfinite(target.conversion_factor_std):
        found.append(f"factor {target.conversion_factor:.4g} ± {target.conversion_factor_std:.2g}")
        found.append(f"coherence {target.coherence:.4f}")
    return ", ".join([*found, "used" if item.used else f"left out: {item.reason}"])


def _target(target: "TargetCalibration") -> str:
    """Scale factor of one of several targets of a camera, and whether the result rests on it."""
    scale = target.scale
    value = "no scale factor"
    if scale is not None:
        value = f"{1e3 * scale.value_m_per_px:.5g} ± {1e3 * math.sqrt(scale.variance):.2g} mm/px"
    return value if target.used else f"{value}, left out"
