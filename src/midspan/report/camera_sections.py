"""The sections on cameras: what each one looks at and how it sees it, and both of them over the record."""

from midspan.recording.cameras.tracked import Eye
from midspan.records import Source
from midspan.report import camera_figures, infrared_figures, page, phase_figures, tables
from midspan.report.material import Material
from midspan.thermal.temperature_range import RangeSurface
from midspan.vision.hybrid import PhaseTracker


def camera(material: Material) -> str:
    """Each camera in a section of its own; empty without one."""
    return "\n".join(_one(material, eye) for eye in material.result.eyes)


def _one(material: Material, eye: Eye) -> str:
    """Frame, region, path, choice and quality of the tracking."""
    direction = eye.calibrations[0].direction
    caption = (
        "The first frame used with the region of interest, the region enlarged, and the target's translation in "
        "the image since then (dot: start). The path should be long in the measured direction "
        f"({direction}) and short across it."
    )
    if eye.source is Source.INFRARED:
        caption += " Grey levels are temperatures: brighter is warmer."
    pieces = [page.figure(camera_figures.frame(eye), "Region of interest", caption)]
    pieces += [_targets(eye), _choice(eye), _active_pixels(eye)]
    caption = (
        "Quality from 0 to 1 and standard deviation of each frame's translation. Drops tell of fog, glare, something "
        "in front of the target, or a blurred picture; their measurements count for less."
    )
    pieces.append(page.figure(camera_figures.tracker(eye, material.clock), "Tracking", caption))
    return page.section(eye.sensor, eye.sensor.capitalize(), *pieces)


def _targets(eye: Eye) -> str:
    """What became of each of several targets; empty for one."""
    found = eye.calibrations[0]
    if len(found.targets) < 2:
        return ""
    return "<h3>Targets</h3>" + page.table(tables.targets(found), tables.TARGETS_HEADER)


def _active_pixels(eye: Eye) -> str:
    """Which pixels the phase was taken from; empty with other trackers."""
    tracker = eye.tracking.targets[0].tracker
    if not isinstance(tracker, PhaseTracker):
        return ""
    caption = "The pixels whose phase tells the translation along x (left) and y (right), tinted over the region."
    return page.figure(phase_figures.active_pixels(tracker), "Active pixels", caption)


def _choice(eye: Eye) -> str:
    tracking = eye.tracking
    if tracking.choice is None:
        return page.paragraph("The region was given, by the settings or by the calibration.", "note")
    caption = (
        "Numbered boxes were tracked for some seconds. Solid ones fit the accelerometer or, where it could not tell, "
        "move like most of the picture; dashed ones do not; red ones were taken."
    )
    if camera_figures.has_map(tracking.choice):
        caption += (
            " Right: the standard deviation with which a region centred there could be tracked; darker is better, grey "
            "was ruled out or lies too near the border."
        )
    drawn = camera_figures.choice(tracking.choice, tracking.reference.pixels)
    return "".join(
        [
            page.figure(drawn, "Choice of the region", caption),
            page.table(tables.candidates(tracking.choice), tables.CANDIDATES_HEADER),
            page.bullets(tracking.choice.reasons, "plain"),
        ]
    )


def cameras(material: Material) -> str:
    """Each camera over the record, which one counts when, the temperature range; empty for one camera of light."""
    if not infrared_figures.worth_showing(material):
        return ""
    caption = (
        "Matches or quality of each camera's best target (zero: lost), marked below where its reference frame changed, "
        "its shutter closed or something stood in front. Then the standard deviations of single frames and of the "
        "result, what the reference frames may be off by included, with the same marks (the colour at their left tells "
        "whose), and the source of each row."
    )
    if material.result.belief is not None:
        caption += " The ground has the colour of the camera that is believed; dashed: another one from there on."
    pieces = [page.figure(infrared_figures.over_time(material), "Cameras over the record", caption)]
    drawn = infrared_figures.zero(material)
    if drawn is not None:
        caption = (
            "How far the second camera's zero lies from the first one's, learnt where both see and taken out. Shading "
            "that moves and surfaces that warm make it wander; where only one sees it is bridged, with a wider band."
        )
        pieces.append(page.figure(drawn, "Zero of the second camera", caption))
    pieces += [_range(eye.sensor, eye.tracking.range_surface) for eye in material.result.eyes]
    return page.section("cameras", "Cameras over the record", *pieces)


def _range(sensor: str, found: RangeSurface | None) -> str:
    """How the temperature range was found; empty where it was not looked for."""
    if found is None:
        return ""
    caption = (
        f"Error of the {sensor} translation against the accelerometer, by the two limits of the temperatures shown. "
        f"Square: the range chosen, {found.best.low_c:.2f} to {found.best.high_c:.2f} °C. A flat floor is usual: many "
        "ranges are as good. “lost”: the target was, in too many frames."
    )
    return page.figure(infrared_figures.surface(found), "Temperature range", caption)
