"""FLIR blocks written byte by byte, without regard to how the reader works."""

import struct

import cv2
import numpy as np

R1, B, F, OFFSET, R2 = 16000.0, 1430.0, 1.0, -5000, 0.011


def black_body(celsius):
    """Counts of a black body of this temperature: Planck's law with the constants above."""
    kelvin = np.asarray(celsius, dtype=np.float64) + 273.15
    return np.rint(R1 / (R2 * (np.exp(B / kelvin) - F)) - OFFSET).astype(np.uint16)


def camera_record(order, stamp_ms, median):
    record = bytearray(2048)

    def put(code, place, *values):
        struct.pack_into(order + code, record, place, *values)

    put("H", 0, 2)
    put("6f", 0x20, 1.0, 0.0, 293.15, 293.15, 293.15, 1.0)
    put("f", 0x3C, 0.5)
    put("3f", 0x58, R1, B, F)
    put("5f", 0x70, 0.006569, 0.01262, -0.002276, -0.00667, 1.9)
    record[0xD4:0xDC] = b"Model 7\0"
    put("i", 0x308, OFFSET)
    put("f", 0x30C, R2)
    put("2i", 0x338, int(median), 100)
    put("2I", 0x384, stamp_ms // 1000, stamp_ms % 1000)
    put("H", 0x464, 30)
    return bytes(record)


def block(counts, *, stamp_ms=1_700_000_000_583, header="<", inner="<", packed=None, calibrated=True, median=None):
    """One FFF block of counts (rows, columns); `packed` replaces the plain pixels, `median` the one in the record."""
    rows, columns = counts.shape
    head = bytearray(32)
    struct.pack_into(inner + "3H", head, 0, 2, columns, rows)
    raw = bytes(head) + (counts.astype(inner + "u2").tobytes() if packed is None else packed)
    records = [(0x01, raw)] + (
        [(0x20, camera_record(inner, stamp_ms, np.median(counts) if median is None else median))] if calibrated else []
    )
    start = 64 + 32 * (len(records) + 1)
    directory, body = b"", b""
    for kind, data in records:
        directory += struct.pack(header + "HHIIII", kind, 2, 100, 1, start + len(body), len(data)) + bytes(12)
        body += data
    directory += bytes(32)  # an unused entry, as cameras leave some
    top = b"FFF\0" + b"test\0".ljust(16, b"\0") + struct.pack(header + "III", 101, 64, len(records) + 1)
    return top.ljust(64, b"\0") + directory + body


def flir_jpeg(data, picture=None, parts=3):
    """A JPEG to look at with an FFF block in segments of its own, as a camera stores it; in `parts` pieces or more."""
    shown = np.random.default_rng(0).integers(0, 255, (24, 32)).astype(np.uint8) if picture is None else picture
    ok, jpeg = cv2.imencode(".jpg", shown)
    assert ok
    jpeg = jpeg.tobytes()
    size = min(-(-len(data) // parts), 65000)
    pieces = [data[k : k + size] for k in range(0, len(data), size)]
    segments = b"".join(
        b"\xff\xe1" + struct.pack(">H", len(piece) + 10) + b"FLIR\0\x01" + bytes([k, len(pieces) - 1]) + piece
        for k, piece in enumerate(pieces)
    )
    exif = b"\xff\xe1" + struct.pack(">H", 2 + 14) + b"Exif\0\0" + bytes(8)
    return jpeg[:2] + exif + segments + jpeg[2:]
