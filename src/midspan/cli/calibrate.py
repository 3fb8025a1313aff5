"""`midspan calibrate RECORDING`."""

import math

import click

from midspan.cli.console import Console, common_options


@click.command("calibrate")
@click.argument("recording", type=click.Path())
@click.option("-o", "--output", type=click.Path(), help="File to write; left out: calibration.json in the recording.")
@click.option("--tracker", help="Tracker, over the recording's own; see `midspan methods`.")
@common_options
def command(recording: str, output: str | None, tracker: str | None, quiet: bool, as_json: bool) -> None:
    """Find scale factor, clock offset and noise levels, and write them to calibration.json."""
    console = Console(quiet, as_json)
    from midspan.cli.estimate import open_with
    from midspan.cli.targets import check_calibration
    from midspan.recording.calibrate import calibrate

    opened = open_with(recording, tracker)
    console.progress(0, 1, "reading the recording")
    target = check_calibration(output, opened) if output else opened.folder
    calibration = calibrate(opened, console.progress)
    console.done()
    file = calibration.save(target)
    describe(console, calibration.to_dict())
    console.warn(calibration.warnings)
    console.say(f"written to {file}")
    console.document({**calibration.to_dict(), "file": str(file)})


def describe(console: Console, tree: dict) -> None:  # type: ignore[type-arg]
    """Print a calibration's values with their standard deviations."""
    rows, acceleration = [], tree["accelerometer"]
    for kind, described in DESCRIBED.items():
        listed = tree.get(kind, [])
        for part in listed if isinstance(listed, list) else [listed]:
            rows += described(part, part.get("name") or kind)
    rows += [
        *_gain(acceleration),
        ("accelerometer noise", f"{1e3 * acceleration['noise_std_m_s2']:.3g} mm/s² per sample"),
        ("noise that goes with the motion", _motion_noise(acceleration["motion_noise_s"])),
        ("accelerometer bias", _bias(acceleration)),
    ]
    console.table(rows)


def _gain(acceleration: dict) -> list[tuple[str, str]]:  # type: ignore[type-arg]
    """The accelerometer's gain where anything is known of it."""
    scale, std = acceleration["scale"], acceleration["scale_std"]
    return [("accelerometer gain", f"{scale:.5g} ± {std:.2g}")] if std > 0.0 else []


def _motion_noise(motion_s: float) -> str:
    return f"{motion_s:.2g} s times its mean square" if motion_s > 0.0 else "none found"


def _bias(acceleration: dict) -> str:  # type: ignore[type-arg]
    value, std = acceleration["bias_m_s2"], acceleration["bias_std_m_s2"]
    return f"{1e3 * value:.4g}" + (" mm/s²" if std is None else f" ± {1e3 * std:.2g} mm/s²")


def _displacement(displacement: dict, name: str) -> list[tuple[str, str]]:  # type: ignore[type-arg]
    """The rows of a displacement sensor; its scale where it was learnt."""
    rows = [
        (f"{name} noise", f"{displacement['noise_std_mm']:.3g} mm per measurement"),
        (f"{name} clock offset", _offset(displacement)),
    ]
    if "scale" not in displacement:
        return rows
    scale, std = displacement["scale"], displacement["scale_std"]
    return [*rows, (f"{name} scale", f"{scale:.5g} ± {std:.2g} ({100 * std / abs(scale):.2g} %)")]


def _camera(camera: dict, name: str) -> list[tuple[str, str]]:  # type: ignore[type-arg]
    """The rows of a camera of light or infrared."""
    scale, std = camera["scale_mm_per_px"], camera["scale_std_mm_per_px"]
    whose = "" if name == "camera" else f"{name} "
    seen = camera.get("temperature_range_c")
    return [
        (f"{whose}scale factor", f"{scale:.5g} ± {std:.2g} mm/px ({100 * std / abs(scale):.2g} %)"),
        (f"{name} clock offset", _offset(camera)),
        (f"{name} noise", f"{camera['noise_std_px']:.2g} px per frame"),
        (
            f"{whose}region of interest",
            ", ".join(str(number) for number in camera["roi"]) + " (x, y, width, height in px)",
        ),
        *([("temperature range", f"{seen[0]:.2f} … {seen[1]:.2f} °C")] if seen else []),
        *_targets(camera),
        *_axes(camera),
    ]


def _radar(radar: dict, name: str) -> list[tuple[str, str]]:  # type: ignore[type-arg]
    """The rows of a radar: what holds for all its targets, then one row for each that was found."""
    factor, std = radar["conversion_factor"], radar["conversion_factor_std"]
    rows = [
        (f"{name} conversion factor", f"{factor:.5g} ± {std:.2g} ({100 * std / abs(factor):.2g} %)"),
        (f"{name} clock offset", _offset(radar)),
        (f"{name} noise", f"{radar['noise_std_mm']:.2g} mm per frame"),
    ]
    for number, target in enumerate(radar["targets"], start=1):
        place = f"at {target['range_m']:.2f} m" if target["range_m"] is not None else f"{number}"
        rows.append((f"{name} target {place}", _radar_target(target)))
    return rows


def _radar_target(target: dict) -> str:  # type: ignore[type-arg]
    """Level, factor, coherence and verdict of a radar's target."""
    found = [] if target["snr_db"] is None else [f"{target['snr_db']:.0f} dB"]
    if target["conversion_factor"] is not None and target["conversion_factor_std"] is not None:
        found.append(f"factor {target['conversion_factor']:.4g} ± {target['conversion_factor_std']:.2g}")
        found.append(f"coherence {target['coherence']:.4f}")
    return ", ".join([*found, "used" if target["used"] else f"left out: {target['reason']}"])


def _targets(camera: dict) -> list[tuple[str, str]]:  # type: ignore[type-arg]
    """One row for each of several targets."""
    rows = []
    for target in camera["targets"] if len(camera["targets"]) > 1 else []:
        scale = target["scale_mm_per_px"]
        value = "no scale factor" if scale is None else f"{scale:.5g} ± {target['scale_std_mm_per_px']:.2g} mm/px"
        rows.append((f"target {target['name']}", value if target["used"] else f"{value}, left out"))
    return rows


def _axes(camera: dict) -> list[tuple[str, str]]:  # type: ignore[type-arg]
    """One row for the second image axis, where there is one."""
    rows = []
    for axis, part in camera.get("axes", {}).items():
        if axis != camera["axis"]:
            how = "with its own acceleration" if part["fused"] else "tracked only"
            rows.append((f"scale factor along {axis}", f"{part['scale_mm_per_px']:.5g} mm/px, {how}"))
    return rows


def _offset(tree: dict) -> str:  # type: ignore[type-arg]
    std = tree["time_offset_std_s"]
    known = "not determined by the motion" if std is None or not math.isfinite(std) else f"± {1e3 * std:.2g} ms"
    return f"{1e3 * tree['time_offset_s']:+.2f} ms {known}"


# How the part of each kind of sensor is printed.
DESCRIBED = {"camera": _camera, "infrared": _camera, "radar": _radar, "displacement": _displacement}
