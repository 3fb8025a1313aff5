"""The figures of camera and calibration: frame and region, its choice, tracking, scale factor, clock offset."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.scale import ScaleCalibration
from midspan.engine.sensor_series import CameraResult
from midspan.records import PixelTrack, Region, Status
from midspan.report.drawing import WIDTH_IN, Colour, Picture, draw_line, draw_points, legend, picture, sheet
from midspan.report.history_data import round_below
from midspan.report.material import Clock
from midspan.report.tables import partly_static
from midspan.report.thinning import envelope, starts
from midspan.vision.active_pixels import ActivePixels
from midspan.vision.roi import RegionChoice

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# The longer side of the picture that is kept of a frame, px.
MAX_FRAME_PX = 960
# The height of a camera's frame across the page, inches.
MAX_FRAME_IN = 6.0
# Under white text on a photograph, in a dark page too.
LABEL_GROUND: dict[str, Any] = {"facecolor": "#000000", "edgecolor": "none", "alpha": 0.6, "pad": 1.5}


def frame(camera: CameraResult) -> Picture:
    """A camera's first frame with the regions and a scale bar; below, the best target's region and its path."""
    pixels = camera.reference
    regions = {target.name: target.region for target in camera.targets}
    region = camera.targets[camera.best].region
    tall = min(WIDTH_IN * pixels.shape[0] / pixels.shape[1], MAX_FRAME_IN)
    figure = sheet(tall + 3.2)
    grid = figure.add_gridspec(2, 2, height_ratios=(tall, 2.8))
    whole, close, path = (figure.add_subplot(place) for place in (grid[0, :], grid[1, 0], grid[1, 1]))
    image(whole, pixels)
    for name, place in regions.items():
        box(whole, place, color=Colour.VERMILLION, linewidth=1.6)
        if len(regions) > 1:
            label(whole, place, name)
    for target in camera.calibrations[0].targets:
        if not target.used:
            box(whole, target.region, color=Colour.ORANGE, linewidth=1.2, linestyle="--")
            label(whole, target.region, target.name)
    _scale_bar(whole, pixels.shape, 1e3 * abs(camera.calibrations[0].scale.value_m_per_px))
    whole.set_title(f"first frame, {pixels.shape[1]} × {pixels.shape[0]} px", fontsize=9)
    image(close, pixels, region)
    close.set_title(f"region, {region.width} × {region.height} px", fontsize=9)
    _path(path, camera.track)
    return picture(figure)


def _scale_bar(axes: "Axes", shape: tuple[int, ...], mm_per_px: float) -> None:
    """A round length, of a quarter of the width or less, at the distance of the best target."""
    rows, columns = shape
    length_mm = round_below(0.25 * columns * mm_per_px)
    left, bottom = 0.03 * columns, 0.95 * rows
    line = axes.plot((left, left + length_mm / mm_per_px), (bottom, bottom), color="white", linewidth=3.0)[0]
    line.set_solid_capstyle("butt")
    text = f"{length_mm:g} mm at the target's distance"
    axes.text(left, bottom - 0.02 * rows, text, color="white", fontsize=8, va="bottom", bbox=LABEL_GROUND)


def image(axes: "Axes", pixels: Any, region: Region | None = None) -> None:
    """An image, or a region of it, in its own pixel coordinates, thinned to what the page can show."""
    rows, columns = pixels.shape
    place = region or Region(0, 0, columns, rows)
    cut = pixels[place.slices]
    step = max(1, -(-max(cut.shape) // MAX_FRAME_PX))
    thinned = np.asarray(cut[::step, ::step], dtype=np.float64)
    low, high = np.nanpercentile(thinned, (0.5, 99.5))
    extent = (place.x - 0.5, place.x + place.width - 0.5, place.y + place.height - 0.5, place.y - 0.5)
    axes.imshow(thinned, cmap="gray", vmin=low, vmax=max(high, low + 1e-9), extent=extent, interpolation="none")
    axes.grid(False)
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px)")


def box(axes: "Axes", region: Region, **options: Any) -> None:
    """The outline of a region."""
    from matplotlib.patches import Rectangle

    corner = (region.x - 0.5, region.y - 0.5)
    axes.add_patch(Rectangle(corner, region.width, region.height, fill=False, **options))


def label(axes: "Axes", region: Region, text: str) -> None:
    """A word in the upper left corner of a region."""
    spot = (region.x + 0.06 * region.width, region.y + 0.06 * region.height)
    axes.text(*spot, text, color="white", fontsize=7, va="top", zorder=3, clip_on=True, bbox=LABEL_GROUND)


def _path(axes: "Axes", track: PixelTrack) -> None:
    """Translation of the target in the image, its start marked."""
    known = np.flatnonzero(np.isfinite(track.x_px) & np.isfinite(track.y_px))
    known = known[starts(len(known), MAX_FRAME_PX)]
    axes.plot(track.x_px[known], track.y_px[known], color=Colour.BLUE, linewidth=0.4, alpha=0.7)
    axes.plot(0.0, 0.0, marker="o", color=Colour.VERMILLION, markersize=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px, down)")
    axes.set_title("path of the target", fontsize=9)


def choice(found: RegionChoice, pixels: Any) -> Picture:
    """What the choice of the region looked at: the places that were tracked, and the predicted standard deviation."""
    figure = sheet(3.7)
    # A picture of one place to choose has no map.
    known = has_map(found)
    places, *scores = figure.subplots(1, 2 if known else 1, squeeze=False)[0]
    image(places, pixels)
    # Where the accelerometer was heard it decides, else what most of the picture does.
    heard = any(np.isfinite(candidate.displacement_std_m) for candidate in found.candidates)
    for number, candidate in enumerate(found.candidates, start=1):
        fits = candidate.fixed if not heard else bool(np.isfinite(candidate.displacement_std_m))
        fits = fits and not partly_static(candidate, found)
        colour, line = (Colour.SKY, "-") if fits else (Colour.ORANGE, "--")
        box(places, candidate.region, color=colour, linewidth=1.0, linestyle=line, zorder=2)
        label(places, candidate.region, str(number))
    for axes in scores:
        _scores(axes, found)
    for axes in (places, *scores):
        for region in found.regions:
            box(axes, region, color=Colour.VERMILLION, linewidth=2.0, zorder=2.5)
        axes.set_aspect("equal")
        axes.set_xlim(-0.5, pixels.shape[1] - 0.5)
        axes.set_ylim(pixels.shape[0] - 0.5, -0.5)
    return picture(figure)


def has_map(found: RegionChoice) -> bool:
    """Whether the predicted standard deviation is known over more than a line of places."""
    score = found.score_px
    return min(score.shape) > 1 and bool(np.any(np.isfinite(score) & (score > 0)))


def _scores(axes: "Axes", found: RegionChoice) -> None:
    """The map of the predicted standard deviation, coloured up to five times its best value."""
    score = np.where(np.isfinite(found.score_px) & (found.score_px > 0), found.score_px, np.nan)
    axes.set_facecolor("#eeeeee")
    axes.grid(False)
    axes.set_xlabel("x (px)")
    (x0, x1), (y0, y1) = _edges(found.score_x), _edges(found.score_y)
    top = min(float(np.nanmax(score)), 5.0 * float(np.nanmin(score)))
    shown = axes.imshow(score, cmap="viridis", vmax=top, extent=(x0, x1, y1, y0), interpolation="nearest")
    axes.figure.colorbar(shown, ax=axes, shrink=0.8, label="predicted σ (px)", use_gridspec=False)


def _edges(centres: Any) -> tuple[float, float]:
    half = 0.5 * float(centres[1] - centres[0])
    return float(centres[0]) - half, float(centres[-1]) + half


def tracker(camera: CameraResult, clock: Clock) -> Picture:
    """The tracker's quality and standard deviation frame by frame, lost frames marked."""
    track, learned = camera.track, camera.calibrations[0]
    t = clock.at(track.time_ns + round(1e9 * learned.offset.value_s))
    _, variance = track.along(learned.direction)
    std = np.sqrt(learned.variance_factor * variance)
    figure = sheet(3.2)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, value, name in ((upper, track.quality, "quality"), (lower, std, f"σ along {learned.direction} (px)")):
        known = np.isfinite(value)
        if known.any():
            draw_line(axes, envelope(t[known], value[known], value[known]), Colour.BLUE, name, linewidth=0.8)
        axes.set_ylabel(name)
        axes.margins(x=0.005)
    lost = track.status == Status.LOST
    if lost.any():
        bottom = np.full(int(np.count_nonzero(lost)), 0.03)
        options = {"marker": "|", "markersize": 8, "color": Colour.VERMILLION, "label": f"{len(bottom)} frames lost"}
        draw_points(upper, t[lost], bottom, transform=upper.get_xaxis_transform(), **options)
        upper.legend(handles=upper.lines[-1:], loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    lower.set_xlabel(clock.label)
    figure.align_ylabels()
    return picture(figure)


def scale(found: ScaleCalibration, of: str) -> Picture:
    """The regression behind the scale factor, and the likelihood over the clock offset; of: which camera it is."""
    figure = sheet(3.6)
    left, right = figure.subplots(1, 2)
    _regression(left, found)
    _likelihood(right, found)
    right.set_xlabel(f"clock offset of the {of} (s)")
    return picture(figure)


def _regression(axes: "Axes", found: ScaleCalibration) -> None:
    fit = found.search.fit
    w = fit.whitened
    # Innovations just after a pause are uncertain and would only blow up the axes.
    usual = w.variance < 4.0 * np.median(w.variance)
    x, y = 1e3 * w.response[usual], w.translation[usual]
    draw_points(axes, x, y, marker=".", markersize=3.0, color=Colour.GREY, label=f"{len(x)} frames")
    reach = np.array([-1.0, 1.0]) * float(np.max(np.abs(x)))
    slope, std = fit.ratio / 1e3, float(np.sqrt(fit.ratio_variance)) / 1e3
    axes.plot(reach, slope * reach, color=Colour.BLUE, linewidth=1.2, label=f"slope {slope:.4g} ± {std:.2g} px/mm")
    wide = 1.96 * std * np.abs(reach)
    axes.fill_between(reach, slope * reach - wide, slope * reach + wide, color=Colour.SKY, alpha=0.5, linewidth=0)
    axes.set_xlabel("acceleration's response, whitened (mm)")
    axes.set_ylabel("translation in the image, whitened (px)")
    legend(axes, 2)


def _likelihood(axes: "Axes", found: ScaleCalibration) -> None:
    search = found.search
    curve = search.likelihood - search.likelihood.max()
    axes.plot(search.offsets_s, curve, color=Colour.BLUE, label="scanned")
    axes.axvline(
        search.fit.offset_s, color=Colour.GREEN, linewidth=1.2, linestyle="--", label=f"{search.fit.offset_s:+.4f} s"
    )
    if search.runner_up is not None:
        # Refined values do not lie on the scanned curve; the mark does, and the legend says how far behind it is.
        x, lead = search.runner_up.offset_s, search.fit.likelihood - search.runner_up.likelihood
        label = f"runner-up {x:+.4f} s, {lead:.0f} behind"
        options: dict[str, Any] = {
            "marker": "v",
            "linestyle": "none",
            "color": Colour.ORANGE,
            "markeredgecolor": Colour.BLACK,
        }
        axes.plot(x, np.interp(x, search.offsets_s, curve), label=label, **options)
    axes.set_ylabel("log-likelihood relative to the best")
    legend(axes, 2)


def explained(found: ScaleCalibration) -> float:
    """Share (0 to 1) of the whitened translation's power that the acceleration explains."""
    fit = found.search.fit
    whole = np.sum(fit.whitened.translation**2 / fit.whitened.variance)
    return float(1.0 - fit.noise * np.sum(fit.residual**2) / whole)


def active_pixels(found: ActivePixels, reference: NDArray[Any]) -> Picture:
    """The region in the `reference` frame (rows, columns), and its active pixels along x and y tinted."""
    region = found.region
    pixels = np.asarray(reference, dtype=np.float64)
    cut = pixels[region.slices]
    low, high = np.nanpercentile(cut, (0.5, 99.5))
    grey = np.clip((cut - low) / max(high - low, 1e-9), 0.0, 1.0)
    figure = sheet(3.2)
    whole, *others = figure.subplots(1, 3)
    whole.set_title(f"region, {region.width} × {region.height} px", fontsize=9)
    whole.imshow(_tinted(grey, None, ""))
    for axes, axis, mask, fit, colour in zip(
        others, "xy", (found.x, found.y), found.r_squared, (Colour.ORANGE, Colour.SKY), strict=True
    ):
        how = f"learned, R² = {fit:.4f}" if np.isfinite(fit) else "by amplitude"
        axes.set_title(f"active along {axis}: {100.0 * float(np.mean(mask)):.0f} % ({how})", fontsize=9)
        axes.imshow(_tinted(grey, mask, colour))
    for axes in (whole, *others):
        axes.grid(False)
        axes.set_xlabel("x in the region (px)")
    return picture(figure)


def _tinted(grey: Any, active: Any, colour: str) -> Any:
    """An image (rows, columns, 3) from 0 to 1 with the pixels of the mask coloured."""
    from matplotlib.colors import to_rgb

    out = np.repeat(grey[:, :, None], 3, axis=2)
    if active is not None:
        out[active] = 0.5 * (out[active] + np.array(to_rgb(colour)))
    return out
