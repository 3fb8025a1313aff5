"""NumPy arrays: npy (plain or structured) and npz (one array a channel)."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.tree import Leaf, channels_of


def read(path: Path) -> ChannelSet:
    """All numeric arrays of an npy or npz file; single numbers named `rate_hz`, `fs` … in an npz give the rate."""
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return channels_of([Leaf("", loaded)])
    with loaded as archive:
        return channels_of([Leaf(name, _member(archive[name])) for name in archive.files])


def _member(array: NDArray[np.generic]) -> NDArray[np.generic]:
    return array if array.dtype.names else np.asarray(array)
