"""What roll of the camera does to a tracker that knows translation only.

Three kinds of texture, noise-free, rotated about the middle of a region of 128 px: the true translation is zero.
"""

import cv2
import numpy as np

from midspan import Frame, Region, open_tracker
from midspan.simulate.scene.texture import textured_scene

REGION = Region(96, 56, 128, 128)
MIDDLE = (REGION.x + 0.5 * (REGION.width - 1), REGION.y + 0.5 * (REGION.height - 1))
ANGLES_DEG = (0.05, 0.2, 0.5, 1.0)

print("texture    " + "".join(f"{angle:>26g}°" for angle in ANGLES_DEG))
for texture in ("natural", "blocks", "facade"):
    image = textured_scene(texture, (240, 320), rng=np.random.default_rng(2)).render(0.0, 0.0)
    tracker = open_tracker("template", Frame(0, image), REGION)
    cells = []
    for k, angle in enumerate(ANGLES_DEG, start=1):
        turn = cv2.getRotationMatrix2D(MIDDLE, angle, 1.0)
        turned = cv2.warpAffine(image, turn, (320, 240), flags=cv2.INTER_LANCZOS4)
        found = tracker.push(Frame(k * 1_000_000_000, turned))
        error, std = np.hypot(found.x_px, found.y_px), np.sqrt(found.variance_x_px2 + found.variance_y_px2)
        cells.append(f"{error:.4f} px (says ±{std:.3f})")
    print(f"{texture:8s}   " + "".join(f"{cell:>27s}" for cell in cells))
