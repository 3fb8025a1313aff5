"""What compression makes of a translation is no vibration of a bracket."""

from types import SimpleNamespace

import pytest

from midspan.calibration.camera.calibrate import of_codec
from midspan.vision.picture_report import Compression, PictureCounts, PictureReport


@pytest.mark.parametrize(
    ("std_px", "periods", "codec_px", "expected"),
    [
        (0.026, 0.69, 0.032, True),
        # Larger than the codec's, lightly damped as a bracket, a raw film.
        (0.06, 0.69, 0.032, False),
        (0.026, 5.0, 0.032, False),
        (0.026, 0.69, 0.0, False),
    ],
)
def test_a_damped_error_of_the_size_that_a_codec_makes_is_the_codecs(std_px, periods, codec_px, expected) -> None:
    own = SimpleNamespace(sways=True, hertz=10.0, time_s=periods / 10.0, std=std_px)
    picture = PictureReport(Compression(0.7, 0.04, codec_px), PictureCounts(), 0.0)
    assert of_codec(own, picture) is expected  # type: ignore[arg-type]
