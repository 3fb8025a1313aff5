"""An exposure that a compressed film seems to have: the sentence names the compression as well."""

from midspan.calibration.camera.calibrate import doubt_exposures
from midspan.notices import Notice

NOTICES = [Notice("exposure", "camera: an exposure of 38 ms."), Notice("tilt", "accelerometer: it tilts.")]


def test_compression_is_named_where_there_is_one():
    doubted = doubt_exposures(NOTICES, 0.03)
    assert doubted[0].startswith(NOTICES[0])
    assert "compression" in doubted[0]
    assert (doubted[0].code, doubted[1]) == ("exposure", NOTICES[1])
    assert doubt_exposures(NOTICES, 0.0) == NOTICES
