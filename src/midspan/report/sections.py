"""The sections of the page in their order; each one: Material → HTML."""

import json

import numpy as np

from midspan._version import __version__
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.radar_trace import RadarTrace
from midspan.engine.sensor_series import CameraResult
from midspan.notices import Severity, coded, worst_first
from midspan.recording.observed import observed
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
        inside = "" if share is None else f", {tables.percent(share)} inside the band"
        text += f" Error against the reference without its zero: {found.without_zero.rmse_mm:.2g} mm rms{inside}."
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
    pieces.append(page.collapsible(f"all {len(found)} in order of time", whole, "events"))
    return page.section("events", title, *pieces, closed=True)


def displacement(material: Material) -> str:
    """The time history."""
    return page.section("displacement", "Displacement", _history(material))


def _history(material: Material, along: str = "", before: str = "") -> str:
    """The time history with how to read it; along: the axis in its title."""
    caption = "Line: estimate. Light area: band of ±1.96 σ, which should contain 95 % of the truth. Below: σ. "
    if material.comparison is not None:
        caption += "Wide line: reference. "
    if np.any(material.result.estimate.status != Status.TRACKING):
        caption += (
            "Orange: coasting on the accelerometer alone. Red: no measurement for more than 10 s or 10 intervals. "
        )
    attributes, kept = chart_of(material)
    text = f"{before}{caption}{_moved(material)}{kept}"
    return page.figure(figures.history(material), f"Displacement{along}", text, attributes)


def band(material: Material) -> str:
    """What the standard deviations are made of, and what they cannot contain."""
    said = [page.paragraph(f"{name}: {text}") for name, text in observed(material.result.settings).items()]
    pieces = [page.table(tables.band(material)), *said]
    if material.result.not_in_band:
        pieces += [page.paragraph("Errors outside the band:"), page.bullets(material.result.not_in_band, "plain")]
    return page.section("band", "What the band contains", *pieces, closed=True)


def closer(material: Material) -> str:
    """Error against the reference, and the liveliest seconds."""
    title = "Fastest motion" if material.comparison is None else "Error against the reference"
    return page.section("closer", title, *_closer(material), closed=True)


def _closer(material: Material, along: str = "") -> list[str]:
    """Error and zoom with their captions; along: the axis in their titles."""
    pieces = []
    if material.comparison is not None:
        caption = (
            "Result minus reference with the mean removed, because the two zeros may differ (legend: the mean). A "
            "correct band contains 95 % of it. A slope is drift; an error that resembles the motion is a wrong scale "
            "or clock."
        )
        pieces = [page.table(tables.comparison(material.comparison))]
        pieces.append(page.figure(figures.error(material), f"Error{along or ' against the reference'}", caption))
    caption = (
        "The segment with the largest velocity. Points: the sensors' measurements with ±1.96 σ, shifted to the "
        "result's zero; most bars should touch the line. Below: the same minus the displacement, to show the band."
    )
    return [*pieces, page.figure(figures.zoom(material), f"Fastest motion{along}", caption)]


def _moved(material: Material) -> str:
    if material.reference_moved_mm == 0.0:
        return ""
    return f"The reference is shifted by {material.reference_moved_mm:+.4g} mm, the mean difference of the zeros. "


def second_axis(material: Material) -> str:
    """Time history, error and liveliest seconds along the second image axis; empty without one."""
    second = material.second
    if second is None:
        return ""
    axis, camera = second.result.axis, second.result.calibration.first_camera
    assert camera is not None
    how = (
        "This axis has its own accelerometer column and was fused in the same way."
        if camera.fused
        else "This axis has no accelerometer: only the camera was smoothed, and the band widens between frames. "
        f"Positive: the structure moves {'to the right' if axis == 'x' else 'down'} in the image."
    )
    along = f" along {axis}"
    note = page.paragraph(f"Image axis {axis}; the rest of this page is along {material.result.axis}. {how}")
    calibrated = page.table(tables.calibrated(second.result.calibration))
    pieces = [note, _history(second, along, "As above, along this axis. "), *_closer(second, along), calibrated]
    return page.section("second-axis", f"Displacement along {axis}", *pieces, closed=True)


def spectra(material: Material) -> str:
    """Natural frequencies, spectra and coherence."""
    modes = figures.natural_frequencies(material)
    caption = (
        "Amplitude spectral densities (Welch). Peaks are natural frequencies or steady excitation; the floor of a "
        "single sensor is its noise, which fusion lowers. Shaded: beyond the alias-free band of a sensor, where its "
        "spectrum shows aliased motion only."
    )
    if material.acceleration is not None and material.measured:
        caption += (
            " Below: coherence of the sensor's measurements with the acceleration, 1 where both measure the same "
            "motion; dashed: 95 % limit of unrelated records."
        )
    pieces = [page.figure(figures.spectra(material, modes), "Spectra", caption)]
    if modes:
        how = (
            "Each peak is fitted as an oscillator driven by white noise, by the likelihood of the periodogram "
            "(Whittle 1953); ± is one standard deviation."
        )
        pieces += [page.table(tables.modes(modes), tables.MODES_HEADER), page.paragraph(how, "note")]
    else:
        pieces.append(page.paragraph("No peak is significant, or the record is too short.", "note"))
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
            "Left: translation in the image against the motion predicted from the acceleration, both through the "
            "same filter, one point per frame. The slope is the inverse scale factor; a thin straight cloud is a "
            f"good calibration (the acceleration explains {tables.percent(share)} of the variance). Right: "
            "log-likelihood of other clock offsets relative to the best; one clear peak is needed. Runner-up: the "
            "second best offset."
        )
        if camera.diagnostics is None:
            here = diagnostics.scale
            caption += (
                f" Scale factor in the calibration file: {1e3 * camera.scale.value_m_per_px:.6g} mm/px; estimated "
                f"from this recording: {1e3 * here.value_m_per_px:.6g} ± {1e3 * here.variance**0.5:.2g} mm/px."
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
            "The calibration file contains values, not the measurements behind them, and this recording does not "
            "determine them. See the report of the calibrated recording."
        )
    if found.radar is not None and found.displacement is None:
        return "The radar section shows the data behind its conversion factor and clock offset."
    if found.displacement is not None and found.displacement.scale_std > 0.0:
        return (
            "Scale, noise levels and clock offset of the displacement sensor were estimated against the accelerometer."
        )
    return "The unit of the displacement sensor is given; only noise levels and clock offset were estimated."


def innovations(material: Material) -> str:
    """Measured minus predicted."""
    found = figures.innovations_of(material)
    if not any(len(own.time_ns) for _, own in found):
        return ""
    caption = (
        "Each measurement minus the filter's prediction. About 95 % should lie between the lines, without a pattern; "
        "the histogram should follow the normal curve. Wider: the noise is underestimated or the target moves. "
        "Crosses: rejected outliers. Points beyond the axis are drawn at its border and counted in the corner. After "
        "a gap the lines are wider."
    )
    if len(found) > 1:
        caption += " One row per sensor; their expected deviations differ."
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
            "Mean power in the calibration window over range. Dots: targets in use with their rank; crosses: unused "
            "peaks (reasons below)."
        )
        pieces.append(page.figure(radar_figures.profile(found, found.diagnostics), "Range profile", caption))
    caption = "Coherence: share of a target's acceleration that the accelerometer explains. Clutter: "
    caption += "amplitude of other reflectors in its bin, relative to its own."
    pieces += [page.table(tables.radar_targets(found), tables.RADAR_HEADER), page.paragraph(caption, "note")]
    if found.diagnostics is not None:
        caption = (
            f"The best target, {found.best.place}, in the window. Left: its phasors turn about the cross as the "
            "range changes; static clutter moves the cross away from zero and is subtracted. Right: amplitude over "
            "phase. Flat: correct; a wave: static clutter remains; a wide band: moving clutter."
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
            "The fastest seconds of the best target. Points: measured (wrapped) phase; blue: unwrapped with the "
            "accelerometer, as used; orange: plain unwrapping from here on. Below: the range rate, at most "
            f"{1e3 * trace.speed_m_s:.3g} mm/s, {'beyond' if beyond else 'below'} the limit of plain unwrapping, "
            f"{1e3 * trace.limit_speed_m_s:.3g} mm/s."
        )
        drawn = radar_figures.phase(trace, material.clock)
        pieces.append(page.figure(drawn, "Phase, measured and unwrapped", caption))
    caption = (
        "Above: the unwrapped phase of the best target; dotted lines: the cycle was resolved again after an outage. "
        "Below: the amplitude of each target relative to the calibration; frames outside the dashed limits are "
        "blocked; orange: not used."
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
        f"Lengths in mm, times in s after {first:.3f} s on the accelerometer's clock, frequencies in Hz.",
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
        "The first frame used, with the region of interest; below: the region enlarged, and the target's translation "
        "in the image since that frame (dot: start). The path should be long in the measured direction "
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
        caption = (
            "Active pixels, whose phase gives the translation along x (left) and y (right), tinted over the region."
        )
        drawn = camera_figures.active_pixels(active, found.reference)
        pieces.append(page.figure(drawn, "Active pixels", caption))
    caption = (
        "Quality, the agreement with the first frame's target, from 0 (none) to 1 (identical), and the standard "
        "deviation of each frame's translation. Drops indicate fog, glare, occlusion or blur; these measurements get "
        "less weight."
    )
    pieces.append(page.figure(camera_figures.tracker(found, material.clock), "Tracking", caption))
    return page.section(found.sensor, found.sensor.capitalize(), *pieces, closed=True)


def _choice(material: Material, found: CameraResult) -> str:
    if found.choice is None:
        own = material.section_of(found)
        where = (
            "the settings"
            if own.roi is not None or own.target
            else "the calibration file, which does not state the selection"
        )
        return page.paragraph(f"The region was given by {where}.", "note")
    caption = (
        "Numbered boxes were tracked for some seconds. Red: selected. Solid: agrees with the accelerometer or, if "
        "that does not decide, with most of the image. Dashed: disagrees, or was not compared with the "
        "accelerometer; the table below gives the reason."
    )
    if camera_figures.has_map(found.choice):
        caption += (
            " Right: expected standard deviation of a region centred at each pixel; darker is better, grey is "
            "excluded or too near the border."
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
        "Matches or quality of each camera's best target (zero: lost); marks below: new reference frame, closed "
        "shutter, occlusion. Then the standard deviations of single frames and of the result, including the error of "
        "the reference frames, with the same marks (the colour at their left names the camera), and the source of "
        "each row."
    )
    if len(material.result.cameras) > 1:
        caption += " Background colour: source of the rows; dashed: switch to the other camera."
    pieces = [page.figure(infrared_figures.over_time(material), "Cameras over the record", caption)]
    for camera in material.result.cameras:
        surface = camera.range_surface
        if surface is not None:
            caption = (
                f"Error of the {camera.sensor} translation against the accelerometer, over the two limits of the "
                f"temperature range. Square: the selected range, {surface.best.low_c:.2f} to "
                f"{surface.best.high_c:.2f} °C. A flat minimum is usual: many ranges are equally good. “lost”: the "
                "target was lost in too many frames."
            )
            pieces.append(page.figure(infrared_figures.surface(surface), "Temperature range", caption))
    return page.section("cameras", "Cameras over the record", *pieces, closed=True)
