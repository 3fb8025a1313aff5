"""Thermal JPEG of DJI cameras: recognised, so that a refusal says whose counts they are. They are not read."""

from pathlib import Path

from midspan.errors import DataError
from midspan.sources.thermal.flir_jpeg import is_jpeg, segments

_APP1, _APP3 = 0xE1, 0xE3
_MAKER = b"DJI"
# Counts of two bytes of DJI's smallest thermal camera, 160 × 120 px; pictures of light have no such segments.
_MIN_COUNT_BYTES = 2 * 160 * 120


def refuse_dji(file: Path) -> None:
    """Raise DataError for a JPEG in whose segments a DJI camera wrote counts. What cannot be read is not judged."""
    if not is_jpeg(file) or not file.is_file():
        return
    is_made, count_bytes = False, 0
    try:
        with file.open("rb") as data:
            for marker, count in segments(data):
                is_made = is_made or (marker == _APP1 and _MAKER in data.read(count))
                count_bytes += count if marker == _APP3 else 0
    except OSError:
        return
    if is_made and count_bytes >= _MIN_COUNT_BYTES:
        raise DataError(
            f"{file}: a thermal JPEG of DJI. Its 16-bit counts are there, in a form that only DJI's Thermal SDK turns "
            "into temperatures; what shows without it are 8-bit grey levels. Convert the files to float TIFF in °C "
            "(dji_irp -a measure of that SDK), or give them to [camera] as pictures."
        )
