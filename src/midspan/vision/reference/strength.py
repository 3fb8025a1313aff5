"""How well a target still resembles its reference frame, and predictions counted from another one."""

import math

from midspan.records import Prediction


def relative(prediction: Prediction | None, x_px: float, y_px: float) -> Prediction | None:
    """A prediction counted from a frame that lies x, y px from the one it counts from now."""
    if prediction is None:
        return None
    return Prediction(prediction.x_px - x_px, prediction.y_px - y_px, prediction.std_x_px, prediction.std_y_px)


def share_lost(strength: float, usual: float) -> float:
    """Share (0 to 1) of its usual strength that a reference has lost."""
    return min(max(1.0 - strength / max(usual, 1e-9), 0.0), 1.0) if math.isfinite(strength) else 1.0
