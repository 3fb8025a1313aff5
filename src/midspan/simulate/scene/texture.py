"""Textures for scenes, drawn at eight samples a pixel in DN (0 … 255): what structures stand in front of."""

import numpy as np

from midspan import _core
from midspan.checks import option
from midspan.records import Floats
from midspan.simulate.scene.scene import REACH_PX, SAMPLES, Scene, canvas_shape, scene_of

TEXTURES = {
    "natural": "1/f noise of 30 DN rms, the statistics of natural scenes",
    "blocks": "dead leaves: overlapping rectangles of all sizes with sharp edges",
    "facade": "brickwork with rows of windows; repeats itself",
    "weak": "1/f noise of 4 DN rms, as of fog or a bare wall",
}


def textured_scene(
    name: str, size_px: tuple[int, int], *, rng: np.random.Generator, reach_px: float = REACH_PX, lens_px: float = 0.6
) -> Scene:
    """A scene of `size_px` (rows, columns) of the texture `name`, one of TEXTURES, seen through a lens of `lens_px`."""
    option("texture", name, TEXTURES)
    shape = canvas_shape(*size_px, reach_px=reach_px)
    if name == "natural":
        canvas = natural(shape, 30.0, rng=rng)
    elif name == "weak":
        canvas = natural(shape, 4.0, rng=rng)
    elif name == "blocks":
        canvas = blocks(shape, rng=rng)
    else:
        canvas = facade(shape, rng=rng)
    return scene_of(canvas, lens_px=lens_px, reach_px=reach_px)


def natural(shape: tuple[int, int], std_dn: float, *, rng: np.random.Generator) -> Floats:
    """Gaussian noise (samples down, across) whose amplitude falls as 1/f, of `std_dn`, about 128 DN."""
    from scipy import fft

    frequency = np.hypot(fft.fftfreq(shape[0])[:, None], fft.rfftfreq(shape[1]))
    frequency[0, 0] = np.inf
    # Nothing above two cycles a pixel passes the lens, so only the lower frequencies need to be drawn.
    kept = frequency < 2 / SAMPLES
    spectrum = np.zeros(frequency.shape, dtype=np.complex128)
    count = int(np.count_nonzero(kept))
    spectrum[kept] = (rng.standard_normal(count) + 1j * rng.standard_normal(count)) / frequency[kept]
    field: Floats = fft.irfft2(spectrum, s=shape, workers=2)
    canvas: Floats = 128 + field * (std_dn / field.std())
    return canvas


def blocks(shape: tuple[int, int], *, rng: np.random.Generator) -> Floats:
    """Dead leaves (samples down, across): rectangles of 2 to 40 px, small ones commonest, of even tones 30 … 225 DN."""
    area_px = shape[0] * shape[1] / SAMPLES**2
    count = int(area_px / 12)
    # Sizes with a density falling as the cube look the same at every scale, as natural scenes do.
    sizes = SAMPLES / np.sqrt(rng.uniform(1 / 40.0**2, 1 / 2.0**2, (count, 2)))
    corners = rng.integers(0, np.array(shape), (count, 2))
    boxes = np.concatenate([corners, np.rint(sizes).astype(np.int64)], axis=1)
    return _core.paint_boxes(shape, 128.0, boxes, rng.uniform(30, 225, count))


def facade(shape: tuple[int, int], *, rng: np.random.Generator) -> Floats:
    """Brickwork of 9 by 4 px with mortar, and dark windows of 18 by 26 px every 44 by 56 px (samples down, across)."""
    down, across = (np.arange(size) / SAMPLES for size in shape)
    course = np.floor(down / 4.0).astype(np.int64)
    place = across[None, :] + 4.5 * (course % 2)[:, None]
    brick = np.floor(place / 9.0).astype(np.int64)
    tones = rng.normal(135, 16, (course.max() + 1, brick.max() + 1))
    canvas: Floats = tones[course[:, None], brick]
    canvas[(down % 4.0 < 0.6)[:, None] | (place % 9.0 < 0.6)] = 185.0
    windows = ((down % 56 > 15) & (down % 56 < 41))[:, None] & ((across % 44 > 13) & (across % 44 < 31))
    frames = ((down % 56 > 13) & (down % 56 < 43))[:, None] & ((across % 44 > 11) & (across % 44 < 33))
    canvas[frames] = 215.0
    panes = rng.normal(55, 14, (int(down.max() // 56) + 1, int(across.max() // 44) + 1))
    pane = panes[(down // 56).astype(np.int64)[:, None], (across // 44).astype(np.int64)]
    return np.where(windows, pane, canvas)
