"""What `track` says of compression: only of lossy files, and by the axis that the target moves along."""

from fractions import Fraction

import cv2
import numpy as np
import pytest

from midspan.recording.tracking.track import track
from midspan.simulate.scene.texture import textured_scene

ROI = (40, 20, 56, 56)


def moving_along_x(path, noise=0.0):
    rng = np.random.default_rng(7)
    scene = textured_scene("natural", (96, 160), rng=rng, reach_px=48.0)
    images = [scene.render(float(x), 0.0) + rng.normal(0.0, noise, (96, 160)) for x in path]
    return [np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in images]


@pytest.mark.parametrize("suffix", [".npy", ".tif", ".png", ".bmp"])
def test_pictures_that_were_stored_without_loss_are_never_called_compressed(tmp_path, suffix):
    # A noise-free film by whole pixels: the next picture holds what the one before it held, as after a codec.
    images = moving_along_x(np.repeat(np.arange(20.0), 2))
    if suffix == ".npy":
        source = tmp_path / "stack.npy"
        np.save(source, np.stack(images))
    else:
        source = tmp_path
        for k, image in enumerate(images):
            assert cv2.imwrite(str(tmp_path / f"image{k:03d}{suffix}"), image)
    reported = " ".join(track(source, roi=ROI, rate_hz=10.0).warnings)
    assert "compressed" not in reported
    assert "missing" not in reported


def test_motion_along_x_is_not_said_to_be_missing(tmp_path):
    import av

    path = 1.5 * np.sin(2 * np.pi * 0.7 * np.arange(50) / 10.0)
    with av.open(tmp_path / "film.mkv", "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "23"})
        stream.width, stream.height, stream.pix_fmt = 160, 96, "gray"
        for k, image in enumerate(moving_along_x(path, noise=2.0)):
            frame = av.VideoFrame.from_ndarray(image, format="gray")
            frame.pts, frame.time_base = k, Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    reported = " ".join(track(tmp_path / "film.mkv", roi=ROI).warnings)
    assert "compressed" in reported
    assert "much of it may be missing" not in reported
