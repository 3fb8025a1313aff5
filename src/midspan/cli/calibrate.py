"""`midspan calibrate RECORDING`."""

import math
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, common_options
from midspan.papers.published import PAPER_KEYS

if TYPE_CHECKING:
    from midspan.settings.stored.calibration import Calibration


@click.command("calibrate")
@click.argument("recording", type=click.Path())
@click.option("-o", "--output", type=click.Path(), help="File to write. Default: calibration.json in the recording.")
@click.option("--tracker", help="Tracker; overrides the recording's.")
@click.option("--literal", is_flag=True, help="Scale factors and clock offset as printed in the papers.")
@click.option("--paper", type=click.Choice(PAPER_KEYS), help="Tracker, calibration and keys of one paper.")
@common_options
def command(recording: str, output: str | None, quiet: bool, as_json: bool, **options: Any) -> None:
    """Find scale factor, clock offset and noise levels, and write them to calibration.json."""
    console = Console(quiet, as_json)
    from midspan.cli.estimate import open_with
    from midspan.cli.targets import check_calibration
    from midspan.recording.calibrate import calibrate

    literal, paper = options["literal"], options["paper"]
    opened = open_with(recording, options["tracker"], literal=literal, fused=False, paper=paper)
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
    from midspan.report.tables import calibrated

    rows = [(label.replace(": ", " "), value) for label, value in calibrated(calibration)]
    for name, _, sensor in calibration.sensors:
        if isinstance(sensor, RadarCalibration):
            for item in sensor.targets:
                found, factor = item.target, item.target.conversion_factor
                words = [f"{found.snr_db:.0f} dB"] if math.isfinite(found.snr_db) else []
                if math.isfinite(factor) and math.isfinite(found.conversion_factor_std):
                    words.append(f"factor {factor:.4g} ± {found.conversion_factor_std:.2g}")
                    words.append(f"coherence {found.coherence:.4f}")
                words.append("used" if item.used else f"not used: {item.reason}")
                rows.append((f"{name} target {found.place}", ", ".join(words)))
        elif isinstance(sensor, CameraCalibration) and len(sensor.targets) > 1:
            for target in sensor.targets:
                value, scale = "no scale factor", target.scale
                if scale is not None:
                    value = f"{1e3 * scale.value_m_per_px:.5g} ± {1e3 * math.sqrt(scale.variance):.2g} mm/px"
                rows.append((f"{name} target {target.name}", value if target.used else f"{value}, not used"))
    camera = None if calibration.across is None else calibration.across.first_camera
    if camera is not None:
        how = "with its own acceleration" if camera.fused else "tracked only"
        value = f"{1e3 * camera.scale.value_m_per_px:.5g} mm/px, {how}"
        rows.append((f"scale factor along {camera.direction}", value))
    console.table(rows)
