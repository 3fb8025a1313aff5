"""The sections on cameras: what each one looks at and how it sees it, and both of them over the record."""

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.sensor_series import CameraResult
from midspan.records import Source
from midspan.report import camera_figures, infrared_figures, page, phase_figures, tables
from midspan.report.material import Material
from midspan.thermal.temperature_range import RangeSurface


def camera(material: Material) -> str:
    """Each camera in a section of its own; empty without one."""
    return "\n".join(_one(material, found) for found in material.result.cameras)


def _one(material: Material, found: CameraResult) -> str:
    """Frame, region, path, choice and quality of the tracking."""
    learnt = found.calibrations[0]
    caption = (
        "The first frame used with the region of interest; below, the region enlarged, and the target's translation in "
        "the image since then (dot: start). The path should be long in the measured direction "
        f"({learnt.direction}) and short across it."
    )
    if found.source is Source.INFRARED:
        caption += " Grey levels are temperatures: brighter is warmer."
    pieces = [page.figure(camera_figures.frame(found), "Region of interest", caption)]
    pieces += [_targets(learnt), _choice(material, found), _active_pixels(found)]
    caption = (
        "Quality, how well the target of the first frame is found again, from 0 (not at all) to 1 (as it was), and the "
        "standard deviation of each frame's translation. Drops show fog, glare, something in front of the target or "
        "blur; these measurements count for less."
    )
    pieces.append(page.figure(camera_figures.tracker(found, material.clock), "Tracking", caption))
    return page.section(found.sensor, found.sensor.capitalize(), *pieces)


def _targets(learnt: CameraCalibration) -> str:
    """What became of each of several targets; empty for one."""
    if len(learnt.targets) < 2:
        return ""
    return "<h3>Targets</h3>" + page.table(tables.targets(learnt), tables.TARGETS_HEADER)


def _active_pixels(found: CameraResult) -> str:
    """Which pixels the phase was taken from; empty with other trackers."""
    active = found.targets[0].active_pixels
    if active is None:
        return ""
    caption = "The pixels whose phase tells the translation along x (left) and y (right), tinted over the region."
    return page.figure(phase_figures.active_pixels(active, found.reference), "Active pixels", caption)


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
    pieces += [_range(found.sensor, found.range_surface) for found in material.result.cameras]
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
