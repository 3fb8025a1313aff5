"""The sections of the page in their order; each one: Material → HTML."""

import json

import numpy as np

from midspan._version import __version__
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.radar_trace import RadarTrace
from midspan.engine.sensor_series import CameraResult
from midspan.notices import Severity, coded, worst_first
from midspan.records import NANOSECONDS, Source, Status
from midspan.report import camera_figures, figures, infrared_figures, page, radar_figures, tables
from midspan.report.history_data import chart_of
from midspan.report.material import Material, shown_here
from midspan.settings.stored.calibration import Calibration
from midspan.sinks.table import ResultTable, metadata_json

# Warnings that stand open on the page.
MAX_OPEN = 3


def verdict(material: Material) -> str:
    """The result in a sentence, with what a reference differs by; a serious warning shows in its colour."""
    severities = {one.severity for one in map(coded, material.result.warnings)}
    coloured = next((f" {worst}" for worst in (Severity.SERIOUS, Severity.WARNING) if worst in severities), "")
    text, found = material.result.verdict, material.comparison
    if found is not None:
        # The zeros may differ by definition; a scale, a sign or a clock that is wrong shows without them.
        share = found.without_zero.coverage_95
        inside = "" if share is None else f", {tables.percent(share)} of it inside the band"
        text += f" The reference differs by {found.without_zero.rmse_mm:.2g} mm rms besides its zero{inside}."
    return page.paragraph(text, f"verdict{coloured}")


def warnings(material: Material) -> str:
    """The worst warnings; the others open on a click."""
    found = list[str](worst_first(material.result.warnings))
    if material.problem is not None:
        found.insert(0, f"The reference could not be used. {material.problem}")
    if material.comparison is not None:
        found += [f"Reference: {note}" for note in material.comparison.notes]
    if not found:
        return ""
    pieces = [page.bullets(found[:MAX_OPEN], "warnings")]
    if rest := found[MAX_OPEN:]:
        pieces.append(page.collapsible(f"{len(rest)} more", page.bullets(rest, "warnings")))
    return page.section("warnings", "Warnings", *pieces)


def events(material: Material) -> str:
    """All events: a table of a few; of many one a kind, that opens on a click. Empty without one."""
    found = material.result.events
    if not found:
        return ""
    title = f"Events ({len(found)})"
    header = (material.clock.label, "event", "what happened")
    if len(found) <= tables.FEW_EVENTS:
        return page.section("events", title, page.table(tables.events(material, found), header), closed=True)
    pieces = []
    for kind in dict.fromkeys(event.kind for event in found):
        rows = tables.events(material, [event for event in found if event.kind == kind])
        when = f"at {rows[0][0]} s" if len(rows) == 1 else f"from {rows[0][0]} to {rows[-1][0]} s"
        pieces.append(page.collapsible(f"{kind}: {len(rows)}, {when}", page.table(rows, header), "events"))
    whole = page.table(tables.events(material, found), header)
    pieces.append(page.collapsible(f"all {len(found)} in the order of time", whole, "events"))
    return page.section("events", title, *pieces, closed=True)


def displacement(material: Material) -> str:
    """The time history."""
    return page.section("displacement", "Displacement", _history(material))


def _history(material: Material, along: str = "", before: str = "") -> str:
    """The time history with how to read it; along: the axis in its title."""
    caption = (
        "The line is the estimate, the light area its band of ±1.96 standard deviations: 95 % of the truth should "
        "lie inside. σ, one of them, is drawn below. "
    )
    if material.comparison is not None:
        caption += "The wide line underneath is the reference. "
    if np.any(material.result.estimate.status != Status.TRACKING):
        caption += "Orange shading: coasting, from the accelerometer alone; red shading: no measurement for long. "
    attributes, kept = chart_of(material)
    text = f"{before}{caption}{_moved(material)}{kept}"
    return page.figure(figures.history(material), f"Displacement{along}", text, attributes)


def band(material: Material) -> str:
    """What the standard deviations are made of, and what they cannot contain."""
    pieces = [page.table(tables.band(material))]
    if material.result.not_in_band:
        pieces += [page.paragraph("What the band cannot contain:"), page.bullets(material.result.not_in_band, "plain")]
    return page.section("band", "What the band contains", *pieces, closed=True)


def closer(material: Material) -> str:
    """Error against the reference, and the liveliest seconds."""
    title = "The liveliest seconds" if material.comparison is None else "Error against the reference"
    return page.section("closer", title, *_closer(material), closed=True)


def _closer(material: Material, along: str = "") -> list[str]:
    """Error and zoom with their captions; along: the axis in their titles."""
    pieces = []
    if material.comparison is not None:
        caption = (
            "What is left after the reference is taken away, counted from its mean: the two zeros may differ, and the "
            "legend says by how much. An honest band holds 95 % of it; a slope is a drift; error that looks like the "
            "motion is a wrong scale or clock."
        )
        pieces = [page.table(tables.comparison(material.comparison))]
        pieces.append(page.figure(figures.error(material), f"Error{along or ' against the reference'}", caption))
    caption = (
        "The segment with the largest velocity. Points are the sensors' own measurements with their ±1.96 standard "
        "deviations, moved to the result's zero: most bars should touch the line. Below, the same minus the "
        "displacement, so that the band can be seen."
    )
    return [*pieces, page.figure(figures.zoom(material), f"The liveliest seconds{along}", caption)]


def _moved(material: Material) -> str:
    if material.reference_moved_mm == 0.0:
        return ""
    return f"The reference is drawn moved by {material.reference_moved_mm:+.4g} mm, the mean difference of the zeros. "


def second_axis(material: Material) -> str:
    """Time history, error and liveliest seconds along the second image axis; empty without one."""
    second = material.second
    if second is None:
        return ""
    axis, camera = second.result.axis, second.result.calibration.first_camera
    assert camera is not None
    how = (
        "It has its own column of acceleration and was fused in the same way."
        if camera.fused
        else "It has no accelerometer: the camera alone was smoothed, so the band opens between frames. Positive is "
        f"where the structure moves {'to the right' if axis == 'x' else 'down'} in the image."
    )
    along = f" along {axis}"
    note = page.paragraph(f"The axis {axis} of the image; all else on this page is along {material.result.axis}. {how}")
    calibrated = page.table(tables.calibrated(second.result.calibration))
    pieces = [note, _history(second, along, "As above, along this axis. "), *_closer(second, along), calibrated]
    return page.section("second-axis", f"Displacement along {axis}", *pieces, closed=True)


def spectra(material: Material) -> str:
    """Natural frequencies, spectra and coherence."""
    modes = figures.natural_frequencies(material)
    caption = (
        "Amplitude densities by Welch's method. Peaks are natural frequencies, or what drives the structure steadily; "
        "the floor of a sensor alone is its noise, which fusion lowers. Above its alias-free band, which is shaded, a "
        "sensor alone shows nothing, and faster motion appears in it at wrong frequencies."
    )
    if material.acceleration is not None and material.measured:
        caption += (
            " Below: coherence of the sensor's own measurements with the acceleration, 1 where both measure the same "
            "motion; dashed: what unrelated records stay below in 95 % of the frequencies."
        )
    pieces = [page.figure(figures.spectra(material, modes), "Spectra", caption)]
    if modes:
        how = (
            "Each peak is fitted as an oscillator with white force by the likelihood of the periodogram (Whittle "
            "1953); ± is a standard deviation."
        )
        pieces += [page.table(tables.modes(modes), tables.MODES_HEADER), page.paragraph(how, "note")]
    else:
        pieces.append(page.paragraph("No peak stands out beyond chance, or the record is too short for one.", "note"))
    return page.section("spectra", "Natural frequencies and spectra", *pieces, closed=True)


def calibration(material: Material) -> str:
    """What was estimated about the sensors, and what it rests on."""
    found = material.result.calibration
    pieces = [page.table(tables.calibrated(found))]
    cameras = [(name, camera) for name, _, camera in found.sensors if isinstance(camera, CameraCalibration)]
    shown = [(name, camera, camera.diagnostics or shown_here(material.result, name)) for name, camera in cameras]
    first = cameras[0][0] if cameras else ""
    for sensor, camera, diagnostics in shown:
        if diagnostics is None:
            continue
        share = camera_figures.explained(diagnostics)
        caption = (
            "Left: translation in the image against the motion that the acceleration predicts, both passed through the "
            "same filter, one point a frame. The slope is the inverse of the scale factor; a thin straight cloud is a "
            f"good calibration (here the acceleration explains {tables.percent(share)} of the variance). Right: how "
            "much less likely other clock offsets are; one clear peak is needed, the runner-up is the next best."
        )
        if camera.diagnostics is None:
            here = diagnostics.scale
            caption += (
                f" The calibration came from a file, with {1e3 * camera.scale.value_m_per_px:.6g} mm/px: this is what "
                f"the recording itself shows, {1e3 * here.value_m_per_px:.6g} ± {1e3 * here.variance**0.5:.2g} mm/px."
            )
        title = "Scale factor and clock offset" + ("" if sensor == first else f" of the {sensor}")
        pieces.append(page.figure(camera_figures.scale(diagnostics, sensor), title, caption))
    if all(diagnostics is None for _, _, diagnostics in shown):
        pieces.append(page.paragraph(_no_figures(found), "note"))
    return page.section("calibration", "Calibration", *pieces, closed=True)


def _no_figures(found: Calibration) -> str:
    """Why there is no figure of what a calibration rests on, in a sentence."""
    if found.first_camera is not None:
        return (
            "The calibration came from a file, which holds its values and not the measurements behind them, and this "
            "recording cannot show them. A report of the recording that was calibrated draws these."
        )
    if found.radar is not None and found.displacement is None:
        return "What the radar's conversion factor and clock offset rest on is shown in the section on the radar."
    if found.displacement is not None and found.displacement.scale_std > 0.0:
        return "Scale, noise levels and clock offset of the displacement sensor come from the accelerometer."
    return "The unit of the displacement sensor is known, so that only noise levels and clock offset were estimated."


def innovations(material: Material) -> str:
    """Measured minus predicted."""
    found = figures.innovations_of(material)
    if not any(len(own.time_ns) for _, own in found):
        return ""
    caption = (
        "Each measurement minus what the filter expected just before it. About 95 % should lie between the lines, "
        "without a pattern; the histogram should follow the normal curve. Wider: noise is underestimated or the target "
        "moves on its own. Crosses were rejected as outliers. What lies beyond the axis is drawn at its border and "
        "counted in the corner. After a gap more is expected and allowed."
    )
    if len(found) > 1:
        caption += " A row for each sensor: of one more is expected than of another."
    drawn = page.figure(figures.innovations(material), "Innovations", caption)
    return page.section("innovations", "Innovations", drawn, closed=True)


def radar(material: Material) -> str:
    """Range profile, targets, circle, phase and amplitudes of each radar; empty without one."""
    sensors, traces = material.result.calibration.sensors, material.result.radars
    radars = [(name, known) for name, _, known in sensors if isinstance(known, RadarCalibration)]
    return "\n".join(_one_radar(material, name, known, traces.get(name)) for name, known in radars)


def _one_radar(material: Material, name: str, found: RadarCalibration, trace: RadarTrace | None) -> str:
    pieces = []
    if found.diagnostics is not None:
        caption = (
            "Mean power of the calibration window over range. Dots: targets in use with their rank; crosses: peaks "
            "that were not used, for the reasons below."
        )
        pieces.append(page.figure(radar_figures.profile(found, found.diagnostics), "Range profile", caption))
    caption = "Coherence is the share of a target's acceleration that the accelerometer explains; clutter "
    caption += "the amplitude of something else in its bin, as a share of its own."
    pieces += [page.table(tables.radar_targets(found), tables.RADAR_HEADER), page.paragraph(caption, "note")]
    if found.diagnostics is not None:
        caption = (
            f"The best target, {found.best.place}, in the window. Left: its phasors turn about the cross "
            "as the range changes; what is static in the bin moves the cross away from zero and is taken out. "
            "Right: amplitude over phase; flat is right, a wave is what is static, a wide band other things that "
            "move."
        )
        pieces.append(page.figure(radar_figures.circle(found, found.diagnostics), "Circle of the phasors", caption))
    if trace is not None:
        pieces.append(_radar_phase(material, trace))
    return page.section(name, name.capitalize(), *pieces, closed=True)


def _radar_phase(material: Material, trace: RadarTrace) -> str:
    """Phase, speed and amplitudes over the record."""
    pieces = []
    if trace.excerpt is not None:
        beyond = trace.speed_m_s > trace.limit_speed_m_s
        caption = (
            "The fastest seconds of the best target. Points: the phase as measured, within a cycle; blue: unwrapped "
            "with the accelerometer, as used; orange: unwrapped plainly from here on. Below, the speed of the range, "
            f"which reached {1e3 * trace.speed_m_s:.3g} mm/s, {'beyond' if beyond else 'below'} the "
            f"{1e3 * trace.limit_speed_m_s:.3g} mm/s from which plain unwrapping fails."
        )
        drawn = radar_figures.phase(trace, material.clock)
        pieces.append(page.figure(drawn, "Phase, measured and unwrapped", caption))
    caption = (
        "Above, the unwrapped phase of the best target; dotted lines: the cycle had to be found anew after an outage. "
        "Below, the amplitude of each target over that of the calibration, with the limits (dashed) outside which a "
        "frame is blocked; orange ground: not used."
    )
    pieces.append(page.figure(radar_figures.amplitudes(trace, material.clock), "Targets over the record", caption))
    return "".join(pieces)


def numbers(material: Material) -> str:
    """Figures and settings as tables."""
    pieces = [page.table(tables.figures(material)), "<h3>Settings</h3>", page.table(tables.settings(material))]
    return page.section("numbers", "Figures and settings", *pieces, closed=True)


def footer(material: Material) -> str:
    """How to cite, and everything that is needed to repeat the run."""
    metadata = material.result.metadata()
    text = metadata_json(ResultTable(columns={}, time_ns=material.result.estimate.time_ns[:0], metadata=metadata), 2)
    first = int(material.result.estimate.time_ns[0]) / NANOSECONDS
    lines = (
        f"To cite: “displacement estimated with midspan {__version__}, method {material.result.method}, calibration of "
        f"{material.result.calibration.created}”, together with the settings above, which make the result repeatable.",
        f"Lengths in mm, times in s from {first:.3f} s of the accelerometer's clock on, frequencies in Hz.",
    )
    written = page.verbatim(json.dumps(tables.named_only(json.loads(text)), indent=2))
    return page.collapsible("Settings, calibration and events as JSON", written) + page.footer(lines)


def camera(material: Material) -> str:
    """Each camera in a section of its own; empty without one."""
    return "\n".join(_one(material, found) for found in material.result.cameras)


def _one(material: Material, found: CameraResult) -> str:
    """Frame, region, path, choice and quality of the tracking."""
    learned = found.calibrations[0]
    caption = (
        "The first frame used with the region of interest; below, the region enlarged, and the target's translation in "
        "the image since then (dot: start). The path should be long in the measured direction "
        f"({learned.direction}) and short across it."
    )
    if found.source is Source.INFRARED:
        caption += " Grey levels are temperatures: brighter is warmer."
    pieces = [page.figure(camera_figures.frame(found), "Region of interest", caption)]
    if len(learned.targets) > 1:
        pieces += ["<h3>Targets</h3>", page.table(tables.targets(learned), tables.TARGETS_HEADER)]
    pieces.append(_choice(material, found))
    active = found.targets[0].active_pixels
    if active is not None:
        caption = "The pixels whose phase tells the translation along x (left) and y (right), tinted over the region."
        drawn = camera_figures.active_pixels(active, found.reference)
        pieces.append(page.figure(drawn, "Active pixels", caption))
    caption = (
        "Quality, how well the target of the first frame is found again, from 0 (not at all) to 1 (as it was), and the "
        "standard deviation of each frame's translation. Drops show fog, glare, something in front of the target or "
        "blur; these measurements count for less."
    )
    pieces.append(page.figure(camera_figures.tracker(found, material.clock), "Tracking", caption))
    return page.section(found.sensor, found.sensor.capitalize(), *pieces, closed=True)


def _choice(material: Material, found: CameraResult) -> str:
    if found.choice is None:
        own = material.section_of(found)
        where = (
            "the settings" if own.roi is not None or own.target else "the calibration file, without how it was chosen"
        )
        return page.paragraph(f"The region was given by {where}.", "note")
    caption = (
        "Numbered boxes were tracked for some seconds. Red: selected. Solid: fits the accelerometer or, where that "
        "does not decide, moves like most of the image. Dashed: does not, or was not compared with the accelerometer; "
        "the table below says why."
    )
    if camera_figures.has_map(found.choice):
        caption += (
            " Right: the standard deviation with which a region centred there could be tracked; darker is better, grey "
            "was ruled out or lies too near the border."
        )
    drawn = camera_figures.choice(found.choice, found.reference)
    return "".join(
        [
            page.figure(drawn, "Choice of the region", caption),
            page.table(tables.candidates(found.choice), tables.CANDIDATES_HEADER),
            page.bullets(found.choice.reasons, "plain"),
        ]
    )


def cameras(material: Material) -> str:
    """Each camera over the record, which one the rows rest on, the temperature range; empty for one camera of light."""
    if not infrared_figures.worth_showing(material):
        return ""
    caption = (
        "Matches or quality of each camera's best target (zero: lost), marked below where its reference frame changed, "
        "its shutter closed or something stood in front. Then the standard deviations of single frames and of the "
        "result, what the reference frames may be off by included, with the same marks (the colour at their left tells "
        "whose), and the source of each row."
    )
    if len(material.result.cameras) > 1:
        caption += " The ground has the colour of the rows' source; dashed: the other camera measures from there on."
    pieces = [page.figure(infrared_figures.over_time(material), "Cameras over the record", caption)]
    for camera in material.result.cameras:
        surface = camera.range_surface
        if surface is not None:
            caption = (
                f"Error of the {camera.sensor} translation against the accelerometer, by the two limits of the "
                f"temperatures shown. Square: the range chosen, {surface.best.low_c:.2f} to {surface.best.high_c:.2f} "
                "°C. A flat floor is usual: many ranges are as good. “lost”: the target was, in too many frames."
            )
            pieces.append(page.figure(infrared_figures.surface(surface), "Temperature range", caption))
    return page.section("cameras", "Cameras over the record", *pieces, closed=True)
