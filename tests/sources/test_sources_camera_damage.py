"""Files of frames that are damaged are refused with what is wrong with them."""

import cv2
import numpy as np
import pytest

from midspan.errors import DataError
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest

AT_5 = FrameRequest(rate_hz=5.0)


def tiff(path, pages=6):
    frames = np.random.default_rng(1).integers(0, 255, (pages, 40, 50)).astype(np.uint8)
    assert cv2.imwritemulti(str(path), list(frames), [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    return path.read_bytes()


def test_a_tiff_of_pages_that_broke_off_is_refused_and_a_whole_one_is_not(tmp_path):
    file = tmp_path / "a.tif"
    whole = tiff(file)
    assert open_frames(file, AT_5).info.frame_count == 6
    file.write_bytes(whole[: 6 * len(whole) // 10])
    with pytest.raises(DataError, match=r"a\.tif is cut off: its page \d is at byte \d+, and the file has"):
        open_frames(file, AT_5)


def test_a_file_that_is_no_stack_is_not_answered_with_advice_to_trust_it(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"hello" * 100)
    with pytest.raises(DataError, match="cannot be read as a NumPy stack: File is not a zip file") as reported:
        open_frames(tmp_path / "a.npz", AT_5)
    assert "pickle" not in str(reported.value)
