"""In which order I and Q lie in a capture, judged from the samples themselves.

A complex receiver that suppresses its image band has targets at positive beat frequencies only. Swapping I and Q turns
them to negative ones; pairing the wrong words makes ghosts. But positive frequencies beyond half of the sampling rate
are negative ones too: targets in the farther half of the range look like nearer ones with I and Q swapped.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.radar.layout import ORDERS, Layout, Words, unpack
from midspan.records import Floats

# The sign shows when one half holds this many dB more energy than the other. It is proven when the eighths at both ends
# agree: attached parts and leakage lie in the nearest one, and hardly a receiver passes beat frequencies of the last.
MIN_DB = 6.0
# Pairing is accepted when it packs the energy this many times more densely than the other one.
MIN_DENSITY = 1.3
# The same by the ghosts: what lies half of the range beyond the targets is this share or more of what the wrong pairing
# makes, by this many standard deviations, and at most half as much with the other pairing.
MIN_GHOST, CERTAIN, LESS = 0.3, 6.0, 0.5
# Bins about zero in which attached parts lie, whose window is four bins wide.
NEAR_ZERO = 2
_PAIRINGS = (("IIQQ", "QQII"), ("IQIQ", "QIQI"))


@dataclass(frozen=True, slots=True)
class OrderEvidence:
    """Of each order: energy of the nearer over the farther half of the range, and of the nearest over the farthest
    eighth, dB; how densely the energy lies, 0 … 1, of all and of what is not near zero. Of each pairing, by its first
    letter's order: the ghosts that are there as a share of those that it would make if it were wrong, with deviation.
    """

    halves_db: dict[str, float]
    eighths_db: dict[str, float]
    density: dict[str, float]
    density_alongside: dict[str, float]
    ghosts: tuple[tuple[float, float], ...] = ()

    def paired(self) -> tuple[str, str] | None:
        """The two orders of the pairing that shows, in all that is seen or in the targets alone, or None."""
        for density in (self.density, self.density_alongside):
            first, second = (max(density[order] for order in pair) for pair in _PAIRINGS)
            if first > MIN_DENSITY * second:
                return _PAIRINGS[0]
            if second > MIN_DENSITY * first:
                return _PAIRINGS[1]
        return self._without_ghosts()

    def _without_ghosts(self) -> tuple[str, str] | None:
        """The pairing compared with whose other one there are ghosts: near a quarter of the range they are faint."""
        for right, wrong in ((0, 1), (1, 0)) if len(self.ghosts) == len(_PAIRINGS) else ():
            share, std = self.ghosts[wrong]
            if share > max(MIN_GHOST, CERTAIN * std) and abs(self.ghosts[right][0]) < LESS * share:
                return _PAIRINGS[right]
        return None

    def proves(self, order: str) -> bool:
        """Whether energy lies clearly in the nearer half, and in the nearest eighth too."""
        return self.halves_db[order] >= MIN_DB and self.eighths_db[order] >= MIN_DB

    def reported(self) -> str:
        """The figures, for messages."""
        return ", ".join(f"{order} {value:+.1f} dB" for order, value in self.halves_db.items())


@dataclass(frozen=True, slots=True)
class OrderDecision:
    """The order taken, whether the data decide it, and a sentence about it."""

    order: str
    certain: bool
    text: str


def swapped(order: str) -> str:
    """The order with I and Q exchanged."""
    return {"IIQQ": "QQII", "QQII": "IIQQ", "IQIQ": "QIQI", "QIQI": "IQIQ"}[order]


def weigh_orders(words: Words, layout: Layout) -> OrderEvidence:
    """What whole frames of words (frames · words a frame,) say for each order; complex samples only."""
    layouts = {order: replace(layout, order=order) for order in (ORDERS if layout.lanes == 2 else ("IIQQ", "QQII"))}
    power = {order: _power(words, one) for order, one in layouts.items()}
    half, eighth = layout.profile.samples // 2, layout.profile.samples // 8
    halves_db = {order: _ratio_db(p[1:half], p[half + 1 :]) for order, (_, p) in power.items()}
    nearer = [max(pair, key=lambda order: halves_db[order]) for pair in _PAIRINGS if pair[0] in halves_db]
    none = dict.fromkeys(ORDERS, 0.0)
    return OrderEvidence(
        halves_db=halves_db,
        eighths_db={order: _ratio_db(p[1 : eighth + 1], p[-eighth:]) for order, (_, p) in power.items()},
        # What is attached lies near zero. Without its mean its ghost would outweigh it and speak for the wrong pairing.
        density=none | {order: float(whole @ whole) for order, (whole, _) in power.items()},
        density_alongside=none | {order: _density_alongside(p) for order, (_, p) in power.items()},
        ghosts=tuple(_ghosts(words, layouts[order]) for order in nearer),
    )


def decide_order(evidence: OrderEvidence, claimed: str, *, said: bool) -> OrderDecision:
    """The order of the words: `claimed` by the settings (said) or by the capture software's habit, unless the data
    show another pairing of the words, or prove the other sign where the settings say nothing.
    """
    pair = evidence.paired()
    order = claimed if pair is None or claimed in pair else next(o for o in pair if o[0] == claimed[0])
    figures = f"energy of the nearer over the farther half of the range: {evidence.reported()}"
    if pair is None and (other := _as_clear(evidence, order)):
        text = f"The samples cannot show whether the I/Q order is {order} or {other} ({figures}): the targets lie at a"
        text += f" quarter of the range, where only the sign of the motion differs. {order} is used."
        return OrderDecision(order, False, f"{text} If it is wrong, set radar.iq_order = {other!r}.")
    if evidence.halves_db[order] >= MIN_DB:
        return OrderDecision(order, True, f"I/Q order {order} by the sign of the beat energy ({figures})")
    source = "the settings" if said else "the capture software's default"
    if not said and evidence.proves(swapped(order)):
        other = swapped(order)
        text = f"I/Q order {other} by the sign of the beat energy, against {source} {order} ({figures})."
        return OrderDecision(other, False, f"{text} If it is wrong, set radar.iq_order = {order!r}.")
    text = (
        f"The sign of the beat energy cannot decide the I/Q order ({figures}): either all strong targets lie beyond "
        f"half of the range, or I and Q are swapped. {order} of {source} is used."
    )
    return OrderDecision(order, False, f"{text} If it is wrong, set radar.iq_order = {swapped(order)!r}.")


def _as_clear(evidence: OrderEvidence, order: str) -> str:
    """The order of the other pairing that shows the sign clearly too; empty where none does."""
    others = next(pair for pair in _PAIRINGS if order not in pair)
    return next((one for one in others if evidence.halves_db.get(one, 0.0) >= MIN_DB), "")


def _power(words: Words, layout: Layout) -> tuple[Floats, Floats]:
    """Mean power (samples,) of the windowed chirps as shares of all; the same without their mean and the zero bin."""
    cube = unpack(words, layout).astype(np.complex128)
    window, axes = np.hanning(cube.shape[-1]), tuple(range(cube.ndim - 1))
    whole, moving = (
        np.mean(np.abs(np.fft.fft(part * window, axis=-1)) ** 2, axis=axes)
        for part in (cube, cube - cube.mean(axis=-1, keepdims=True))
    )
    moving[0] = 0.0
    return whole / max(float(whole.sum()), 1e-300), moving / max(float(moving.sum()), 1e-300)


def _ghosts(words: Words, layout: Layout) -> tuple[float, float]:
    """Share of the ghosts that this order would make of the targets that it shows if its pairing were wrong; its
    standard deviation. Near 1: it is wrong; 0: it is right.

    Words paired wrongly mirror a target at the angle w a sample to p = π − w, and repeat it at p − π with
    −i cos p / (1 + sin p) of its phasor: faint near a quarter of the range, where p is w and only the sign turns.
    """
    cube = unpack(words, layout).astype(np.complex128)
    count = cube.shape[-1]
    spectrum = np.fft.fft(cube * np.hanning(count), axis=-1).reshape(-1, count)
    at = np.arange(2 * NEAR_ZERO, count // 2 - 2 * NEAR_ZERO + 1)
    angle = 2.0 * np.pi * at / count
    expected = -1j * np.cos(angle) / (1.0 + np.sin(angle)) * spectrum[:, at]
    found, power = spectrum[:, at + count // 2], float(np.sum(np.abs(expected) ** 2))
    if not power > 0.0:
        return 0.0, np.inf
    share = float(np.sum((np.conj(expected) * found).real)) / power
    rest = np.abs(found - share * expected) ** 2
    # Neighbouring bins of a Hann window share their noise.
    return share, float(np.sqrt(2.0 * np.sum(np.abs(expected) ** 2 * rest))) / power


def _density_alongside(power: Floats) -> float:
    """How densely shares of power (samples,) lie, 0 … 1, apart from what is attached and its ghost."""
    count = len(power)
    away = NEAR_ZERO if count > 8 * NEAR_ZERO else 0
    near = np.arange(-away, away + 1)
    kept = power.copy()
    kept[np.concatenate((near, near + count // 2))] = 0.0
    kept /= max(float(kept.sum()), 1e-300)
    return float(kept @ kept)


def _ratio_db(near: Floats, far: Floats) -> float:
    return float(10.0 * np.log10(max(float(near.sum()), 1e-30) / max(float(far.sum()), 1e-30)))
