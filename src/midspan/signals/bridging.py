"""What is not known of a motion while its acceleration is not seen."""

import numpy as np

from midspan.records import Floats
from midspan.signals.health import dominant_frequency

# Steps up to this many usual ones are jitter or a single lost sample, which the filter takes as they are.
GAP_STEPS = 2.5
# A gap is long when its density is above this share of that of a wholly unknown motion.
LONG_SHARE = 0.1
# Motion is not taken to be slower than this when something has to be bridged.
MIN_HZ = 0.2


def missed_share(length_s: float, frequency_hz: float) -> float:
    """Share of a motion's amplitude that a straight line over `length_s` misses, (2 pi f T)²/8, at most 1."""
    return min(1.0, (2.0 * np.pi * frequency_hz * length_s) ** 2 / 8.0)


def unknown_density(value: Floats, rate_hz: float) -> float:
    """Noise density, (m/s²)²/Hz, for a motion like `value` (n,) that was not seen: its variance over its bandwidth."""
    return float(np.var(value)) / max(dominant_frequency(value, rate_hz), MIN_HZ)
