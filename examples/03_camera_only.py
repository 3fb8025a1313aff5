"""Camera alone: the translation of a target in pixels, frame by frame, from a stack of arrays.

The frames are made here: a textured wall that moves by a sine of 0.3 px, far below the pixel, with the noise of a
small camera. Real frames come as a video, a folder of images or an .npy stack: see `midspan track --help`.
"""

import numpy as np

from midspan import Frame, choose_region, open_tracker
from midspan.simulate.scene.camera import Camera, cramer_rao_std_px
from midspan.simulate.scene.texture import textured_scene

rng = np.random.default_rng(3)
scene = textured_scene("natural", (200, 260), rng=rng)  # rows, columns
camera = Camera()
stamps_s = np.arange(0, 20, 0.1)
true_px = 0.3 * np.sin(2 * np.pi * 0.4 * stamps_s)  # downwards

frames = [
    Frame(time_ns=round(1e9 * t), pixels=camera.expose(scene.render(0.0, float(y)), rng=rng), index=k)
    for k, (t, y) in enumerate(zip(stamps_s, true_px, strict=True))
]

choice = choose_region(frames[:16])
print(f"region {choice.region}")
for reason in choice.reasons:
    print(f"  {reason}")

tracker = open_tracker("template", frames[0], choice.region)
track = [tracker.push(frame) for frame in frames]

y_px = np.array([row.y_px for row in track])
std_px = np.sqrt([row.variance_y_px2 for row in track])
error = (y_px - true_px)[1:]
_, bound_px = cramer_rao_std_px(scene, camera, region=choice.region)
print(
    f"error {np.std(error):.4f} px rms about its mean, {np.mean(error):+.4f} px mean (the reference frame's own noise)"
)
print(f"the tracker says ±{np.median(std_px):.4f} px; the Cramér-Rao bound of the region is {bound_px:.4f} px")
