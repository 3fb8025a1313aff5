"""The report's numbers as rows of text: cards, figures, calibration, settings, events."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.sensor_series import CameraResult
from midspan.evaluate.metrics import Agreement, Comparison, normalised_innovation, step_of
from midspan.evaluate.spectrum import Mode
from midspan.fusion.blocks import REJECTED
from midspan.fusion.methods import METHODS
from midspan.records import Event, Region
from midspan.report.material import BAND, Material
from midspan.settings.camera import CameraSettings
from midspan.settings.kinds import KINDS
from midspan.settings.plausible import expected_m_per_px
from midspan.settings.stored.calibration import Calibration
from midspan.settings.stored.sections import offset_words
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.trees import flattened
from midspan.vision.candidates import Candidate
from midspan.vision.roi import RegionChoice

# This many events stand in one table; more are grouped by their kinds.
FEW_EVENTS = 12
# Of the first sensor, scale and clock; those of others stand in the table of figures.
MAX_SENSOR_CARDS = 2
Row = tuple[str, str]
Card = tuple[str, str, str]


def summary(material: Material) -> list[Card]:
    """The cards on top, six at most: label, value, a smaller line."""
    f = material.result.figures()
    value, std = material.result.displacement_mm, material.result.displacement_std_mm
    high, low = int(value.argmax()), int(value.argmin())
    shares = (f"{percent(f['status']['coasting'])} coasting", f"{percent(f['status']['lost'])} lost")
    zero = f"of which the zero, common to all rows: ± {BAND * f['zero_std_mm']:.3g} mm"
    return [
        ("Maximum", f"{value[high]:+.4g} mm", f"± {BAND * std[high]:.3g} mm, at {material.t[high]:.3f} s"),
        ("Minimum", f"{value[low]:+.4g} mm", f"± {BAND * std[low]:.3g} mm, at {material.t[low]:.3f} s"),
        ("Band (95 %)", f"± {BAND * f['median_std_mm']:.3g} mm", f"median; {zero}"),
        *_sensor_cards(material)[:MAX_SENSOR_CARDS],
        ("Tracking", percent(f["status"]["tracking"]), ", ".join(shares)),
    ]


def band(material: Material) -> list[Row]:
    """The standard deviations of the rows and of what is common to all of them."""
    f = material.result.figures()
    return [
        ("standard deviation σ", f"{f['median_std_mm']:.4g} mm (median)"),
        ("σ, largest", f"{float(np.max(material.result.displacement_std_mm)):.4g} mm"),
        ("σ of the zero", f"{f['zero_std_mm']:.4g} mm, common to all rows"),
        ("σ without zero", f"{f['median_own_std_mm']:.4g} mm (median)"),
    ]


def _direction_words(material: Material) -> str:
    """The accelerometer's channel and what a positive displacement is."""
    sensor, axis = material.result.settings.accelerometer, material.result.axis
    name = "" if sensor is None else sensor.value or getattr(sensor, f"value_{axis}", None) or Path(sensor.file).name
    camera, more = material.result.calibration.first_camera, "positive where this acceleration is positive"
    if camera is not None:
        ways = ("left", "right") if camera.direction == "x" else ("up", "down")
        more += f"; the target then moves {ways[camera.scale.value_m_per_px > 0.0]} in the image"
    return f"{name or 'accelerometer'}: {more}"


def _peak(material: Material) -> list[Row]:
    """The largest acceleration without its bias."""
    felt = material.acceleration
    if felt is None or not np.isfinite(felt.value).any():
        return []
    peak = float(np.nanmax(np.abs(felt.value - material.result.calibration.bias_m_s2)))
    return [("peak acceleration without bias", f"{peak / GRAVITY_M_S2:.3g} g")]


def _sensor_cards(material: Material) -> list[Card]:
    """Scale factor and clock offset of each camera, clock offset of the other sensors, with σ."""
    rows, known = list[Card](), {one.name: one.settings for one in material.result.settings.sensors}
    for name, _, sensor in material.result.calibration.sensors:
        if isinstance(sensor, CameraCalibration):
            value, std = 1e3 * sensor.scale.value_m_per_px, 1e3 * math.sqrt(sensor.scale.variance)
            more, settings = f"σ is {100 * std / abs(value):.2g} %", known.get(name)
            expected = expected_m_per_px(settings, sensor) if isinstance(settings, CameraSettings) else None
            more += "" if expected is None else f"; from the optics {1e3 * expected:.3g} mm/px"
            rows.append((f"Scale of the {name}", with_std(value, std, "mm/px"), more))
        if math.isfinite(sensor.offset.variance):
            rows.append((f"Clock of the {name}", offset_words(sensor.offset), "σ; added to its time stamps"))
    return rows


def with_std(value: float, std: float, unit: str) -> str:
    """A value with its standard deviation, both to its second digit."""
    digits = 6 if not 0.0 < std < math.inf else min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{value:.{digits}f} ± {std:.2g} {unit}"


def agreements(found: Comparison) -> list[tuple[str, Agreement]]:
    """Each way of comparing, as `midspan compare` has them."""
    ways = (
        ("as recorded", found.plain),
        ("zero removed", found.without_zero),
        ("zero and lag removed", found.without_zero_and_lag),
    )
    return [(label, one) for label, one in ways if one is not None]


def percent(share: float) -> str:
    """A share as a percentage that never rounds to 0 or 100 what is not."""
    value = 100.0 * share
    if 0.0 < value < 0.1:
        return "<\u00a00.1\u00a0%"
    return ">\u00a099.9\u00a0%" if 99.9 < value < 100.0 else f"{value:.3g}\u00a0%"


def duration(length_s: float) -> str:
    """A length of time for a person."""
    if length_s < 600:
        return f"{length_s:.2f} s"
    hours, rest = divmod(round(length_s), 3600)
    return f"{hours} h {rest // 60:02d} min {rest % 60:02d} s"


def figures(material: Material) -> list[Row]:
    """The figures of the result."""
    f = material.result.figures()
    rate_hz = 1.0 / step_of(material.result.estimate.time_ns)
    length = duration(f["end_s"] - f["start_s"])
    rows = [
        ("method", method_words(material.result.method)),
        ("start, end", f"{f['start_s']:.6f} s, {f['end_s']:.6f} s on the accelerometer's clock"),
        ("span", f"{length}, {f['rows']} rows at {rate_hz:.5g} Hz"),
        ("direction", _direction_words(material)),
        ("motion", f"{f['rms_mm']:.4g} mm rms, {f['largest_mm'] - f['smallest_mm']:.4g} mm peak to peak"),
        *_peak(material),
        *((label, f"{value} ({more})") for label, value, more in _sensor_cards(material)[MAX_SENSOR_CARDS:]),
    ]
    innovation = material.result.innovation
    if len(innovation.verdict):
        normalised = normalised_innovation(innovation)
        rows.append(("measurements used", f"{len(normalised)} of {len(innovation.verdict)}"))
        rows.append(("rejected as outliers", str(int(np.count_nonzero(innovation.verdict == REJECTED)))))
        if len(normalised):
            rows.append(
                ("mean squared innovation / σ²", f"{float(np.mean(normalised**2)):.3g} (1 if the noise is correct)")
            )
    return rows


def method_words(method: str) -> str:
    """A method's name in words, with the one it has in the settings."""
    row = METHODS.get(method)
    return f"{row.title} ({method})" if row is not None and row.title else method


def comparison(found: Comparison) -> list[Row]:
    """The figures against the reference."""
    lag = "not determined" if found.lag_s is None else f"{1e3 * found.lag_s:+.3f} ms (+: the result is later)"
    rows = [("compared", f"{found.count} rows from {found.start_s:.3f} to {found.end_s:.3f} s")]
    for label, one in agreements(found):
        share = one.coverage_95
        covered = "" if share is None else f"; {percent(share)} inside ±{BAND} σ (95 % expected)"
        of_it = (
            "" if (part := one.normalised_rmse_percent) is None else f", {part:.2g} % of the reference's peak to peak"
        )
        rows.append((f"RMSE {label}", f"{one.rmse_mm:.5g} mm{of_it}{covered}"))
    return [
        *rows,
        ("bias (result − reference)", f"{found.bias_mm:+.5g} mm"),
        ("largest error", f"{found.largest_error_mm:.5g} mm at {found.largest_error_at_s:.3f} s"),
        ("correlation", "not defined" if found.correlation is None else f"{found.correlation:.6f}"),
        ("lag", lag),
        ("peak to peak", f"{found.peak_to_peak_mm:.5g} mm; reference {found.reference_peak_to_peak_mm:.5g} mm"),
    ]


MODES_HEADER = ("frequency", "damping ratio", "rms in it")


def modes(found: Sequence[Mode]) -> list[tuple[str, ...]]:
    """The first natural frequencies with damping and σ."""
    return [
        (
            with_std(mode.frequency_hz, mode.frequency_std_hz, "Hz"),
            with_std(100 * mode.damping, 100 * mode.damping_std, "%")
            if math.isfinite(mode.damping)
            else "a tone or several modes",
            f"{mode.rms_mm:.3g} mm",
        )
        for mode in found
    ]


def calibrated(found: Calibration) -> list[Row]:
    """A calibration's values with their standard deviations."""
    rows, motion_s, std, axis = list[Row](), found.motion_noise_s, found.accelerometer_scale_std, found.sensor_axis
    for name, kind, sensor in found.sensors:
        rows += [(f"{name}: {label}", value) for label, value in KINDS[kind].stored.rows(sensor)]
    if std > 0.0:
        rows.append(("accelerometer: gain", f"{found.accelerometer_scale:.5g} ± {std:.2g}"))
    if axis is not None:
        parts = ", ".join(f"{s:+.4f} ± {std:.2g}" for s, std in zip(axis.components, axis.std, strict=True))
        label = "accelerometer: the sensors' axis along cross_values"
        rows.append((label, f"{parts} ({axis.angle_deg:.2g}° off its own)"))
    bias_std = f" ± {1e3 * found.bias_std_m_s2:.2g}" if math.isfinite(found.bias_std_m_s2) else ""
    with_motion = f"{motion_s:.2g} s times the mean square of the acceleration" if motion_s else "none found"
    rows += [
        ("accelerometer: noise", f"{1e3 * found.noise_std_m_s2:.4g} mm/s² per sample"),
        ("accelerometer: noise proportional to the motion", with_motion),
        ("accelerometer: bias", f"{1e3 * found.bias_m_s2:.4g}{bias_std} mm/s²"),
    ]
    usual = found.usual
    if usual is not None and math.isfinite(usual.low_m_s2) and usual.moved_m > 0.0:
        # How lively the calibration was, in units in which a wrong one shows.
        value = f"up to {usual.peak_m_s2 / GRAVITY_M_S2:.2g} g; {1e3 * usual.moved_m:.3g} mm rms"
        rows.append(("accelerometer: motion calibrated on", value))
    return [*rows, ("made", f"{found.created} by midspan {found.version}")]


TARGETS_HEADER = ("target", "region (px)", "scale factor (mm/px)", "noise (px)", "noise (mm)", "used")


def _place(region: Region) -> str:
    return f"{region.x}, {region.y}, {region.width} × {region.height}"


def targets(camera: CameraCalibration) -> list[tuple[str, ...]]:
    """One row a target: where, scale factor, noise, and whether the result rests on it."""
    rows: list[tuple[str, ...]] = []
    for target in camera.targets:
        scale = "refused"
        noise = ("", "")
        if target.scale is not None:
            value = 1e3 * target.scale.value_m_per_px
            scale = f"{value:.5g} ± {1e3 * math.sqrt(target.scale.variance):.2g}"
            noise = (f"{target.noise_std_px:.2g}", f"{abs(value) * target.noise_std_px:.2g}")
        used = "yes" if target.used else f"no: {target.reason}"
        rows.append((target.name, _place(target.region), scale, *noise, used))
    return rows


RADAR_HEADER = ("range (m)", "SNR (dB)", "conversion factor", "noise (mm)", "coherence", "clutter", "decision")


def radar_targets(radar: RadarCalibration) -> list[tuple[str, ...]]:
    """One row a peak of the range profile: the used ones first, each with what speaks for or against it."""
    rows: list[tuple[str, ...]] = []
    rank = 0
    for item in radar.targets:
        target = item.target
        rank += item.used
        factor = ""
        if math.isfinite(target.conversion_factor):
            factor = f"{target.conversion_factor:.5f}\u00a0±\u00a0{target.conversion_factor_std:.5f}"
        rows.append(
            (
                f"{target.range_m:.3f}" if math.isfinite(target.range_m) else f"bin {target.place_bin:.1f}",
                f"{target.snr_db:.1f}",
                factor,
                f"{1e3 * target.noise_m:.2g}" if math.isfinite(target.noise_m) else "",
                percent(target.coherence) if target.coherence > 0.0 else "",
                percent(target.clutter) if math.isfinite(target.clutter) else "",
                f"used, rank {rank}" if item.used else f"no: {item.reason}",
            )
        )
    return rows


CANDIDATES_HEADER = ("place", "region (px)", "predicted σ (px)", "relative to the others (px)", "decision")
# An image that moves less than half as much as the others: its target would be more than twice as far away.
FAR_OFF = 2.0


def candidates(choice: RegionChoice) -> list[tuple[str, ...]]:
    """One row a place that was tried: where, how sharp, how it moves, and why it was taken or not."""
    return [
        (
            str(number),
            _place(found.region),
            f"{found.predicted_std_px:.2g}",
            f"{found.disagreement_px:.2g}" if math.isfinite(found.disagreement_px) else "",
            found.verdict + ("; partly static" if partly_static(found, choice) else ""),
        )
        for number, found in enumerate(choice.candidates, start=1)
    ]


def partly_static(found: Candidate, choice: RegionChoice) -> bool:
    """Whether a place moves so much less in the image than the one taken that part of it does not move at all."""
    taken = [abs(one.scale_m_per_px) for one in choice.candidates if one.region == choice.region]
    return any(abs(found.scale_m_per_px) > FAR_OFF * scale for scale in taken)


def settings(material: Material) -> list[Row]:
    """The settings used, flat, in the words of recording.toml; with what was taken for those that were left out."""
    tree = named_only(material.result.settings.model_dump(mode="json", exclude_none=True))
    for camera in material.result.cameras:
        listed = tree[camera.source.word]
        for own in listed if isinstance(listed, list) else [listed]:
            if own.get("name", camera.sensor) == camera.sensor:
                own |= {
                    key: value for key, value in _taken(camera, material.section_of(camera)).items() if not own.get(key)
                }
    rows = [(key, value) for key, value in flattened(tree) if value != []]
    return [(key, ", ".join(map(str, value)) if isinstance(value, list) else str(value)) for key, value in rows]


# Keys of a sensor's section that hold a file.
FILE_KEYS = ("file", "times", "config")


def named_only(tree: Any) -> Any:
    """Plain values with files by their names alone where the whole path was given: a report goes to other people."""
    if isinstance(tree, list):
        return [named_only(one) for one in tree]
    if not isinstance(tree, dict):
        return tree
    return {key: _name(value) if key in FILE_KEYS else named_only(value) for key, value in tree.items()}


def _name(file: Any) -> Any:
    """The name of a file whose whole path is given; others, and what is no file, as they are."""
    if isinstance(file, str) and Path(file).is_absolute():
        return Path(file).name
    return named_only(file)


def _taken(camera: CameraResult, settings: CameraSettings) -> dict[str, str]:
    """What a camera was tracked with where its settings do not say."""
    found = {}
    if settings.reference is None:
        found["reference"] = f"{settings.reference_rule} (default)"
    if settings.roi is None and not settings.target:
        places = [f"{r.x}, {r.y}, {r.width}, {r.height}" for r in (target.region for target in camera.targets)]
        found["roi"] = f"{'; '.join(places)} ({'chosen' if camera.choice is not None else 'of the calibration'})"
    surface = camera.range_surface
    if surface is not None:
        found["temperature_range_c"] = f"{surface.best.low_c:.2f}, {surface.best.high_c:.2f} (chosen)"
    return found


def events(material: Material, found: Sequence[Event]) -> list[tuple[str, ...]]:
    """Events as rows: time, kind, text."""
    times = material.clock.at(np.array([event.time_ns for event in found], dtype=np.int64))
    return [(f"{at:.3f}", event.kind, event.text) for at, event in zip(times, found, strict=True)]
