"""Films whose container turns the picture for display, as phones write them: the matrix of ISO 14496-12 in the file."""

import struct
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

# a, b, c, d: a stored pixel (x, y) is shown at (a x + c y, b x + d y), up to a shift.
RIGHT, LEFT, OVER = (0, 1, -1, 0), (0, -1, 1, 0), (-1, 0, 0, -1)
MIRRORED, SLANTED = (-1, 0, 0, 1), (0.6, 0.8, -0.8, 0.6)


def stored_for(upright, matrix):
    """The pictures (frames, rows, columns) that a matrix shows as `upright`: each pixel where it comes from."""
    a, b, c, d = matrix
    rows, columns = upright.shape[1:]
    y, x = np.mgrid[:rows, :columns]
    # The inverse of a turn is its transpose.
    from_x, from_y = a * x + b * y, c * x + d * y
    from_x, from_y = from_x - from_x.min(), from_y - from_y.min()
    stored = np.empty((len(upright), from_y.max() + 1, from_x.max() + 1), dtype=upright.dtype)
    stored[:, from_y, from_x] = upright
    return stored


def write(path: Path, pictures, rate_hz=10, matrix=None) -> Path:
    """A film of grey pictures (frames, rows, columns) without loss, with the matrix in its track's header."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate_hz)
        stream.height, stream.width, stream.pix_fmt = *pictures.shape[1:], "gray"
        stream.options = {"qp": "0"}
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="gray")
            frame.pts, frame.time_base = number, Fraction(1, rate_hz)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    if matrix is not None:
        data = bytearray(path.read_bytes())
        # Behind the name: version, two dates, number, reserved, length, reserved, layer, group, volume, reserved.
        place = data.index(b"tkhd") + 4 + 4 + 8 + 4 + 4 + 4 + 8 + 8
        a, b, c, d = (round(value * 0x10000) for value in matrix)
        struct.pack_into(">9i", data, place, a, b, 0, c, d, 0, 0, 0, 1 << 30)
        path.write_bytes(data)
    return path
