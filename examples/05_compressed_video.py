"""What video compression costs: the same small motion tracked in lossless frames and in H.264.

A wall of fine texture moves by a sine of 0.02, 0.1 or 0.5 px. The frames are encoded with x264 at several quality
factors (CRF), decoded and tracked. `gain` is the tracked amplitude over the true one, `noise` what is left.
"""

import io
from fractions import Fraction

import av
import numpy as np

from midspan import Frame, Region, open_tracker
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.texture import textured_scene

RATE_HZ, COUNT = 10, 100
REGION = Region(56, 56, 96, 96)
time_s = np.arange(COUNT) / RATE_HZ
shape = np.sin(2 * np.pi * 0.7 * time_s)
scene = textured_scene("natural", (208, 208), rng=np.random.default_rng(5))


def film(amplitude_px):
    """Noisy pictures of the wall, moving downwards by the amplitude times `shape`."""
    rng, camera = np.random.default_rng(6), Camera()
    return [camera.expose(scene.render(0.0, float(y)), rng=rng) for y in amplitude_px * shape]


def through_h264(pictures, crf):
    """The pictures after encoding and decoding."""
    memory = io.BytesIO()
    with av.open(memory, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=RATE_HZ, options={"crf": str(crf), "preset": "medium"})
        stream.height, stream.width = pictures[0].shape
        stream.pix_fmt = "gray"
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="gray")
            frame.pts, frame.time_base = k, Fraction(1, RATE_HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    memory.seek(0)
    with av.open(memory) as container:
        return [np.ascontiguousarray(picture.to_ndarray(format="gray")) for picture in container.decode(video=0)]


def gain_and_noise(pictures, amplitude_px):
    """Tracked amplitude over the true one, and the rms of what is left, px."""
    frames = [Frame(round(1e9 * t), picture) for t, picture in zip(time_s, pictures, strict=True)]
    tracker = open_tracker("template", frames[0], REGION)
    y_px = np.array([tracker.push(frame).y_px for frame in frames])[1:]
    design = np.column_stack((shape[1:], np.ones(COUNT - 1)))
    found, *_ = np.linalg.lstsq(design, y_px, rcond=None)
    return found[0] / amplitude_px, np.std(y_px - design @ found)


print("amplitude   " + "".join(f"{name:>22s}" for name in ("lossless", "CRF 10", "CRF 18", "CRF 23", "CRF 28")))
for amplitude_px in (0.02, 0.1, 0.5):
    pictures = film(amplitude_px)
    cells = []
    for crf in (None, 10, 18, 23, 28):
        gain, noise = gain_and_noise(pictures if crf is None else through_h264(pictures, crf), amplitude_px)
        cells.append(f"{gain:8.3f}, ±{noise:.4f} px")
    print(f"{amplitude_px:5.2f} px    " + "".join(f"{cell:>22s}" for cell in cells))
print("\nEach cell: gain, then the rms noise of a frame.")
