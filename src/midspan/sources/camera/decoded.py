"""What of a decoded picture is used: its luma without any conversion of colours, turned as players show it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.notices import Notice
from midspan.sources.camera.frames import luma

# What a display matrix of each number of quarter turns, counted counterclockwise, does to a picture in words.
_TURNS = {1: "90 degrees to the left", 2: "180 degrees", 3: "90 degrees to the right"}


def turn_of(picture: Any) -> tuple[int, Notice | None]:
    """How many quarter turns counterclockwise show a decoded picture upright, 0 to 3, and what to tell of it.

    Mirrored pictures, and those turned by another angle, are left as they are.
    """
    matrix = picture.side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return 0, None
    # Its first two rows say where a step to the right and one down in the picture point on the screen, in fixed point.
    (a, b), (c, d) = np.frombuffer(bytes(matrix), dtype=np.int32).reshape(3, 3)[:2, :2].tolist()
    upright, sideways = b == c == 0 and a * d > 0, a == d == 0 and b * c < 0
    text = (
        "its display matrix, a mirror or a rotation by no multiple of 90 degrees, is ignored; directions and "
        "positions are those of the image as stored"
    )
    turns = 0
    if upright or sideways:
        turns = (0 if a > 0 else 2) if upright else (3 if b > 0 else 1)
        text = f"its images are rotated by {_TURNS.get(turns)} (display matrix)"
        text += "; so are directions and positions"
    return turns, None if upright and not turns else Notice("film-turned", text)


def depth_of(pixel_format: str | None) -> int:
    """Bits of the luma (or of a colour) in a pixel format such as yuv420p10le; 8 where it is not known."""
    import av

    if not pixel_format:
        return 8
    try:
        shape = av.VideoFormat(pixel_format)
        bits = int(shape.components[0].bits)
        # Deep colours are brought to 16 bits before they are weighted.
        return 16 if shape.is_rgb and bits > 8 else bits
    except (ValueError, IndexError):
        return 8


def luma_of(picture: Any) -> NDArray[np.generic]:
    """Luma (rows, columns) of a decoded picture: uint8, or uint16 for more than 8 bits.

    Planar YUV and grey give their first plane as it is; packed YUV is taken apart; RGB is weighted as in BT.601.
    """
    shape = picture.format
    name = str(shape.name)
    bits = int(shape.components[0].bits)
    if name.startswith(("yuv", "gray", "nv", "p010", "p012", "p016", "y8")) and not name.startswith(
        ("yuyv", "yuva444p1")
    ):
        plane = _plane(picture, 1 if bits <= 8 else 2, ">" if name.endswith("be") else "<")
        # p010 and its like keep the value in the upper bits.
        shift = 16 - bits if name.startswith(("p010", "p012")) else 0
        return np.ascontiguousarray(plane >> shift if shift else plane)
    if name in ("yuyv422", "uyvy422", "yvyu422"):
        packed = _plane(picture, 1, "<", samples=2 * picture.width)
        return np.ascontiguousarray(packed[:, 1::2] if name == "uyvy422" else packed[:, ::2])
    if shape.is_rgb or name == "pal8":
        colours = picture.to_ndarray(format="rgb24" if bits <= 8 else "rgb48le")
        return luma(colours, reversed_colours=False)
    return np.ascontiguousarray(picture.to_ndarray(format="gray" if bits <= 8 else "gray16le"))


def _plane(picture: Any, width_bytes: int, order: str, samples: int | None = None) -> NDArray[Any]:
    """The first plane (rows, samples) without the padding at the end of its lines, in the machine's byte order."""
    plane = picture.planes[0]
    rows, columns = int(picture.height), int(samples or picture.width)
    kind = np.dtype(f"{order}u{width_bytes}")
    raw = np.frombuffer(plane, dtype=np.uint8)[: rows * plane.line_size].reshape(rows, plane.line_size)
    pixels = raw[:, : columns * width_bytes].copy().view(kind)
    return pixels.astype(kind.newbyteorder("="), copy=False)
