"""Files of frames for tests of damage: whole ones, and changes of their bytes."""

import io
import struct
import zipfile
import zlib
from fractions import Fraction

import av
import cv2
import numpy as np


def moving(count=24, rows=64, columns=96, seed=5):
    """A textured picture that moves one column a frame, with some noise: every frame differs."""
    rng = np.random.default_rng(seed)
    scene = rng.integers(60, 190, (rows, columns + count))
    noise = rng.integers(-4, 5, (count, rows, columns))
    return np.stack([scene[:, k : k + columns] + noise[k] for k in range(count)]).astype(np.uint8)


def write_video(path, frames, codec="ffv1", pixel_format="gray", metadata=None, **options):
    with av.open(str(path), "w") as container:
        container.metadata.update(metadata or {})
        stream = container.add_stream(codec, rate=Fraction(10))
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], pixel_format
        stream.options = options
        for k, image in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=pixel_format)
            picture.pts = k
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


def payloads(path):
    """The bytes of every frame as they lie in a video file."""
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def flip_in_frames(path, numbers):
    """Turn one bit in the middle of some frames of a video."""
    whole = payloads(path)
    data = path.read_bytes()
    for number in numbers:
        changed = bytearray(whole[number])
        changed[len(changed) // 2] ^= 8
        assert data.count(whole[number]) == 1
        data = data.replace(whole[number], bytes(changed))
    path.write_bytes(data)


def flip(path, place, bit=3):
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << bit
    path.write_bytes(data)


def npy_header(shape, dtype="|u1"):
    """The header of an npy file that declares an array of this shape."""
    said = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(said) + 1) + said.encode() + b"\n"


def bomb_npz(path, name, shape, declared_bytes):
    """A compressed npz whose member declares `declared_bytes`, in its header and in the archive's directory."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{name}.npy", npy_header(shape) + bytes(1000))
    data = bytearray(packed.getvalue())
    # The size before packing, in the directory at the end: at most 4 GiB in its four bytes.
    place = data.rindex(b"PK\x01\x02")
    data[place + 24 : place + 28] = struct.pack("<I", min(declared_bytes, 0xFFFFFFFE))
    path.write_bytes(data)
    return path


def png_of(width, height):
    """A PNG of a few bytes that declares a picture of 16-bit colours of this size."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 16, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


def bmp_of(width, height):
    ok, data = cv2.imencode(".bmp", np.zeros((4, 4, 3), np.uint8))
    assert ok
    data = bytearray(data.tobytes())
    data[18:26] = struct.pack("<ii", width, height)
    return bytes(data)


def tiff(pages, loop=False, size=(8, 8)):
    """A plain TIFF of grey pages; with `loop` the last one leads back to the first."""
    width, height = size
    data = bytearray(b"II*\0" + struct.pack("<I", 8))
    for page in range(pages):
        begin = len(data)
        fields = [
            (256, 4, width),
            (257, 4, height),
            (258, 3, 8),
            (259, 3, 1),
            (262, 3, 1),
            (273, 4, begin + 2 + 9 * 12 + 4),
            (277, 3, 1),
            (278, 4, height),
            (279, 4, 64),
        ]
        data += struct.pack("<H", len(fields))
        for tag, kind, value in fields:
            data += struct.pack("<HHII", tag, kind, 1, value)
        after = begin + 2 + 9 * 12 + 4 + 64
        data += struct.pack("<I", after if page < pages - 1 else 8 if loop else 0) + bytes([page]) * 64
    return bytes(data)
