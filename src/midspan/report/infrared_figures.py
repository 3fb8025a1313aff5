"""The figures of cameras over a long record: how well each sees, what the rows rest on, the temperature range."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from midspan.engine.sensor_series import CameraResult
from midspan.records import Event, Floats, Source
from midspan.report.drawing import Colour, Picture, draw_line, legend, picture, sheet
from midspan.report.material import Material
from midspan.report.thinning import envelope, spans
from midspan.thermal.temperature_range import RangeSurface

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {Source.CAMERA: Colour.BLUE, Source.INFRARED: Colour.VERMILLION, Source.PREDICTION: Colour.ORANGE}
OTHER = Colour.GREEN
# Of further cameras of the same kind.
FURTHER = (Colour.PURPLE, Colour.GREEN, Colour.BLACK)
CAMERAS = (Source.CAMERA, Source.INFRARED)
# Trackers whose strength is a number of matches; of the others it is the quality.
MATCHING = ("features",)
# The marks of each camera below the standard deviations take this share of the height.
MARK_HEIGHT = 0.09
# Digits of °C on the surface of temperature ranges.
MIN_DIGITS, MAX_DIGITS = 2, 4


def worth_showing(material: Material) -> bool:
    """Whether there are two cameras, a thermal one, or reference frames that changed."""
    cameras = material.result.cameras
    changed = any(event.kind == "reference" for event in material.result.events)
    return bool(cameras) and (len(cameras) > 1 or cameras[0].source is Source.INFRARED or changed)


def over_time(material: Material) -> Picture:
    """Strength and standard deviation of each camera, its reference changes and shutters, the rows' source."""
    cameras = material.result.cameras
    switches = places(material, [event for event in material.result.events if event.kind == "switch"])
    figure = sheet(1.5 + 1.3 * (len(cameras) + 1))
    *strengths, deviation, strip = figure.subplots(
        len(cameras) + 2, 1, sharex=True, height_ratios=(*(1.0 for _ in cameras), 1.4, 0.35)
    )
    for axes, camera in zip(strengths, cameras, strict=True):
        _strength(axes, material, camera)
    _deviations(deviation, material)
    _strip(strip, material)
    for axes in (*strengths, deviation):
        if len(cameras) > 1:
            # The ground in the colour of the camera that the rows rest on.
            for code, held in source_spans(material).items():
                if code in CAMERAS:
                    over = axes.get_xaxis_transform()
                    axes.broken_barh(held, (0, 1), transform=over, color=COLOURS[code], alpha=0.09, linewidth=0.0)
        for number, place in enumerate(switches):
            # A line from where on the other camera measures.
            label = "switch" if axes is strengths[0] and number == 0 else None
            axes.axvline(float(place), color=Colour.GREEN, linewidth=1.1, linestyle="--", label=label)
    drawn = {
        label: handle for axes in strengths for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    strengths[0].legend(
        drawn.values(), drawn.keys(), loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, borderaxespad=0.2
    )
    strip.set_xlabel(material.clock.label)
    strip.set_xlim(material.t[0], material.t[-1])
    figure.align_ylabels()
    return picture(figure)


def colour_of(material: Material, camera: CameraResult) -> str:
    """A camera's colour: that of its rows, of further ones of the same kind another."""
    alike = [one.sensor for one in material.result.cameras if one.source is camera.source]
    return (COLOURS[camera.source], *FURTHER)[alike.index(camera.sensor) % (1 + len(FURTHER))]


def _strength(axes: "Axes", material: Material, camera: CameraResult) -> None:
    """Matches or quality of the best target; zero where it was lost."""
    late_ns = np.int64(round(1e9 * camera.calibrations[0].offset.value_s))
    t, value = material.clock.at(camera.track.time_ns + late_ns), camera.targets[camera.best].strength
    matching = material.section_of(camera).tracker in MATCHING
    draw_line(axes, envelope(t, value, value), colour_of(material, camera), "", linewidth=0.8)
    axes.set_title(camera.sensor, fontsize=9, loc="left", color=colour_of(material, camera))
    axes.set_ylabel("matches" if matching else "quality (%)")
    axes.set_ylim(0.0, 1.08 * max(float(np.max(value, initial=0.0)), 1.0))
    _marks(axes, material, camera, (0.0, 0.22))


def _marks(axes: "Axes", material: Material, camera: CameraResult, height: tuple[float, float]) -> None:
    """What happened to a camera's targets, between two heights (0 to 1) of the axes."""
    over = axes.get_xaxis_transform()
    hidden = hidden_spans(material, camera)
    if hidden:
        place = (height[0], height[1] - height[0])
        axes.broken_barh(hidden, place, transform=over, color=Colour.ORANGE, alpha=0.6, label="something in front")
    for kind, colour, label in (
        ("reference", Colour.PURPLE, "another reference frame"),
        ("shutter", Colour.BLACK, "shutter"),
    ):
        found = places(material, [event for event in camera.events if event.kind == kind])
        if len(found):
            axes.vlines(found, *height, transform=over, color=colour, linewidth=1.3, label=label)


def hidden_spans(material: Material, camera: CameraResult) -> list[tuple[float, float]]:
    """Start and length (s) of the segments in which something stood in front of a camera's targets."""
    found, since = [], None
    for event in sorted(camera.events, key=lambda event: event.time_ns):
        if event.kind == "hidden" and since is None:
            since = event.time_ns
        if event.kind == "seen" and since is not None:
            found.append((since, event.time_ns))
            since = None
    if since is not None:
        found.append((since, int(material.result.estimate.time_ns[-1])))
    ends = material.clock.at(np.array(found, dtype=np.int64).reshape(-1, 2).ravel()).reshape(-1, 2)
    return [(float(start), float(max(end - start, 0.0))) for start, end in ends]


def _deviations(axes: "Axes", material: Material) -> None:
    """Standard deviation of each camera's single frames and of the result, on a logarithmic axis."""
    for camera in material.result.cameras:
        block = camera.displacement(camera.best)
        seen = np.isfinite(block.value_m) & np.isfinite(block.variance_m2)
        if seen.any():
            t, std = material.clock.at(block.time_ns[seen]), 1e3 * np.sqrt(block.variance_m2[seen])
            draw_line(axes, envelope(t, std, std), colour_of(material, camera), camera.sensor, linewidth=0.8)
    std = material.result.displacement_std_mm
    draw_line(axes, envelope(material.t, std, std), Colour.BLACK, "result", linewidth=1.2)
    axes.set_yscale("log")
    axes.set_ylabel("σ (mm)")
    legend(axes, 4)
    for number, camera in enumerate(material.result.cameras[::-1]):
        low, high = MARK_HEIGHT * number, MARK_HEIGHT * (number + 0.8)
        _marks(axes, material, camera, (low, high))
        # Whose marks they are.
        axes.plot((0.0, 0.0), (low, high), transform=axes.transAxes, color=colour_of(material, camera), linewidth=6.0)


def _strip(axes: "Axes", material: Material) -> None:
    """Which source each row of the result has."""
    for code, held in source_spans(material).items():
        axes.broken_barh(held, (0, 1), color=COLOURS.get(code, OTHER), linewidth=0.0)
    known = shares(material.result.estimate.source)
    axes.set_ylim(0, 1)
    axes.set_yticks([])
    axes.grid(False)
    axes.set_ylabel("source", rotation=0, ha="right", va="center")
    reported = [f"{code.word}: {100.0 * share:.3g} %" for code, share in known]
    handles = [axes.plot([], [], color=COLOURS.get(code, OTHER), linewidth=5.0)[0] for code, _ in known]
    axes.legend(handles, reported, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.2)


def source_spans(material: Material) -> dict[Source, list[tuple[float, float]]]:
    """Start and length (s) of the segments in which the rows rest on each source."""
    source = material.result.estimate.source
    return {code: spans(material.t, source == code) for code, _ in shares(source)}


def shares(source: NDArray[np.uint8]) -> list[tuple[Source, float]]:
    """The sources of rows (n,) that occur, each with its share of them."""
    return [(Source(int(code)), float(np.mean(source == code))) for code in np.unique(source)]


def chosen_place(found: RangeSurface) -> tuple[int, int]:
    """Row and column of the range chosen, where rows and columns go from cold to warm."""
    row = int(np.argmin(np.abs(found.low_c[::-1] - found.best.low_c)))
    return row, int(np.argmin(np.abs(found.high_c - found.best.high_c)))


def reported_apart(values: Floats) -> list[str]:
    """Temperatures (n,) as text with as many digits as tell them apart, two at least, four at most."""
    for digits in range(MIN_DIGITS, MAX_DIGITS):
        found = [f"{value:.{digits}f}" for value in values]
        if len(set(found)) == len(np.unique(values)):
            return found
    return [f"{value:.{MAX_DIGITS}f}" for value in values]


def surface(found: RangeSurface) -> Picture:
    """The error of every temperature range by its two limits, with the range chosen."""
    figure = sheet(3.6, 6.4)
    axes = figure.subplots()
    # Rows fall, columns rise: both axes are drawn from cold to warm.
    error, low = found.error_px[::-1], found.low_c[::-1]
    axes.set_facecolor("#dddddd")
    axes.grid(False)
    shown = axes.imshow(error, cmap="viridis", origin="lower", aspect="auto", interpolation="nearest")
    figure.colorbar(shown, ax=axes, label="error in the band (px)", use_gridspec=False)
    for row, column in np.argwhere(np.isnan(error)):
        axes.text(column, row, "lost", ha="center", va="center", fontsize=7, color=Colour.BLACK)
    row, column = chosen_place(found)
    axes.plot(
        column, row, marker="s", markersize=17, markerfacecolor="none", color=Colour.VERMILLION, markeredgewidth=2.0
    )
    axes.set_xticks(range(len(found.high_c)), reported_apart(found.high_c))
    axes.set_yticks(range(len(low)), reported_apart(low))
    axes.set_xlabel("upper limit (°C): of the region … of the whole view")
    axes.set_ylabel("lower limit (°C)")
    return picture(figure)


def places(material: Material, events: list[Event]) -> Floats:
    """Where events (n,) lie on the time axis, s."""
    return material.clock.at(np.array([event.time_ns for event in events], dtype=np.int64))
