"""From a frame to a pose: steps of all blocks until each lies at its kernels' phase, in one compiled piece."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.records import Floats
from midspan.vision.bank import Store, slots
from midspan.vision.blocks import Mask, fuse, gains
from midspan.vision.kernels import PHASES, Integers, places, project, quantised

MOST_PASSES = 8
NEAR_PX = 0.5 / PHASES + 0.003  # a block this near to its kernels' phase needs no other; the play stops circles
SPARSE, FEWEST_SPARSE = 5, 4  # one block in so many is looked at first, where that leaves not fewer than so many
UNDISTURBED_SHARE = 0.8
OWN_WEIGHT = 1.0  # of a frame's own noise against the usual one
ALIKE = 2.0  # times the usual noise: up to here blocks agree
LARGEST_ROLL_RAD, LARGEST_ZOOM = 0.1, 0.1
LEAST_GAIN, LARGEST_GAIN, LEAST_OWN_GAIN = 0.1, 10.0, 0.25


class Pose(NamedTuple):
    """What one frame gives: whether the steps led to a place at all; x, y (px), roll (rad), zoom and their covariance
    (4, 4); share of the information that agrees; noise of a pixel as the blocks' scatter shows it.
    """

    found: bool
    value: Floats
    covariance: Floats
    share: float
    noise: float

    def wider(self, factor: float, unsure: Floats) -> "Pose":
        """This pose with its own covariance times a `factor`, and that of the zero, `unsure` (4, 4)."""
        return Pose(self.found, self.value, factor * self.covariance + unsure, self.share, self.noise)

    def averaged(self, usual: float) -> float:
        """What makes the variance that of the noise averaged with the `usual`, as few blocks show it only roughly."""
        return (OWN_WEIGHT + (usual / max(self.noise, 1e-300)) ** 2) / (OWN_WEIGHT + 1.0) if usual > 0.0 else 1.0

    def disturbed(self, usual: float) -> float:
        """What makes the variance that of no less than the usual noise, and the wider the less of the target agrees:
        those blocks may err together.
        """
        return (max(1.0, UNDISTURBED_SHARE / self.share) * max(1.0, usual / max(self.noise, 1e-300))) ** 2


@njit(cache=True)
def _steps(sums: Floats, slot: Integers, store: Store, usual: float) -> tuple[Floats, Floats]:
    """Translation (blocks, 2) of each block from its kernels' phase, and its information (blocks, 2, 2), 0 if unfit."""
    gain = gains(sums[:, 2], store.gain_information, usual)
    step, information = np.zeros((len(gain), 2)), np.zeros(store.information.shape)
    for b in range(len(gain)):
        # A covered block's own gain is none, whatever the others' say.
        shown = sums[b, 2] > LEAST_OWN_GAIN * gain[b]
        if np.isfinite(sums[b, 0]) and shown and gain[b] > LEAST_GAIN and gain[b] < LARGEST_GAIN:
            x, y = sums[b, 0] / gain[b], sums[b, 1] / gain[b]
            # Further away than the kernels are used for, the second order is not the rest of it.
            near = (NEAR_PX / max(abs(x), abs(y), NEAR_PX)) ** 2
            for axis in range(2):
                second = store.warp[b, slot[b], axis, 2:]
                rest = 0.5 * second[0] * x * x + second[1] * x * y + 0.5 * second[2] * y * y
                step[b, axis] = sums[b, axis] / gain[b] - near * rest
            information[b] = store.information[b]
    return step, information


@njit(cache=True)
def _levers(store: Store, slot: Integers) -> Floats:
    """What blocks show (blocks, 2, 2) along x and y of a roll of 1 rad and a zoom of 1 about the window's middle.

    A block's middle moves, and what the block shows turns or grows about it: of a disc nothing is left to be seen of a
    roll.
    """
    out = np.empty((len(slot), 2, 2))
    for b in range(len(slot)):
        x, y = store.centres[b, 0], store.centres[b, 1]
        warp = store.warp[b, slot[b]]
        out[b, 0, 0], out[b, 0, 1] = warp[0, 0] - y, warp[0, 1] + x
        out[b, 1, 0], out[b, 1, 1] = warp[1, 0] + x, warp[1, 1] + y
    return out


@njit(cache=True)
def _products(
    image: NDArray[np.generic], level: float, store: Store, pose: Floats, wanted: Mask
) -> tuple[Floats, Floats, Integers]:
    """Where the kernels next to each block's place lie (blocks, 2), what they give (blocks, 3), their slots (blocks,).

    NaN for blocks that are not `wanted`.
    """
    whole, phase, near = quantised(places(pose, store.centres))
    slot = slots(store, phase, wanted)
    where = (whole[:, 1] + store.origin[0], whole[:, 0] + store.origin[1], slot)
    sums = project(image, level, (store.kernels, store.steps), (store.down, store.across), where)
    return near, sums, slot


@njit(cache=True)
def _approached(image: NDArray[np.generic], level: float, store: Store, begin: Floats) -> Floats:
    """The pose (4,) from `begin` on, moved by the median step of one block in each row and column.

    That is a fifth of the work, and nearly always leads to the phase whose kernels are exact. `begin` where so few
    blocks are not enough.
    """
    columns = len(store.across) - 1
    wanted = np.zeros(len(store.centres), dtype=np.bool_)
    for b in range(len(wanted)):
        wanted[b] = (b % columns + 2 * (b // columns)) % SPARSE == 0 and store.gain_information[b] > 0.0
    at, sums, _ = _products(image, level, store, begin, wanted)
    shown = wanted & (sums[:, 2] > LEAST_OWN_GAIN)
    if shown.sum() < FEWEST_SPARSE:
        return begin
    gain = np.median(sums[shown, 2])
    pose, off = begin.copy(), at - places(begin, store.centres)
    for axis in range(2):
        pose[axis] += np.median(off[shown, axis] + sums[shown, axis] / gain)
    return pose


@njit(cache=True)
def climb(image: NDArray[np.generic], level: float, store: Store, begin: Floats, usual: float) -> Pose:
    """Steps from the pose `begin` (4,) in `image` (rows, columns), of which `level` is subtracted; both count from the
    bank's zero.

    `usual`: the noise to be expected of a pixel, 0 where it is not known.
    """
    pose, covariance = _approached(image, level, store, begin + store.zero), np.full((4, 4), np.inf)
    share, noise, found = 0.0, np.inf, False
    total = store.information[:, 0, 0] + store.information[:, 1, 1]
    everywhere = np.ones(len(total), dtype=np.bool_)
    for turn in range(MOST_PASSES):
        at, sums, slot = _products(image, level, store, pose, everywhere)
        step, information = _steps(sums, slot, store, usual)
        levers = _levers(store, slot)
        # Far from the kernels' phase the steps are not exact: only then may the blocks differ by more than noise.
        expected = usual if turn > 1 else 0.0
        pose, covariance, weight, noise = fuse(at + step, information, levers, pose, expected)
        if not np.isfinite(noise) or abs(pose[2]) > LARGEST_ROLL_RAD or abs(pose[3]) > LARGEST_ZOOM:
            found = False
            break
        share = (weight * total).sum() / total.sum()
        off = np.abs(places(pose, store.centres) - at).max()
        found = off <= 2.0 * NEAR_PX
        agreed = share > UNDISTURBED_SHARE and (usual <= 0.0 or noise < ALIKE * usual)
        if off < NEAR_PX and (turn > 1 or agreed):
            break
    return Pose(found, pose - store.zero, covariance, share, noise)
