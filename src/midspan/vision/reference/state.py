"""What the key-frame tracker remembers: the graph of its key frames, a hand-over, what the target looked like."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from midspan.records import Floats, Floats32, Frame
from midspan.vision.reference.cover import ALL_SEEN, Cells
from midspan.vision.reference.light import inside
from midspan.vision.reference.pictures import Pictures, pictures_of, realigned
from midspan.vision.reference.records import Chain, KeyFrame, clear_share

STRENGTH_FRAMES = 5  # that a strength is averaged over: the usual one, of those after a key frame, and the newest
MIN_PAIRS = 3  # frames in which a new key frame must have been tracked
CLEAR = 0.95  # share of frames' contrast, squared, that a good key frame and they have in common
MIN_CLEAR = 0.67  # of frames' contrast, squared, that they must have in common to make a picture: the rest is noise


@dataclass(frozen=True, slots=True, eq=False)
class Overlap:
    """Frames that make the picture of the key frame `to`: how many so far, their windows; `new`: it is tracked together
    with the one in use, to take over from it, and `places` (2,) px are where each frame says that it lies;
    `hidden` (cells,): where something stands in front in one of them.
    """

    to: int
    new: bool
    frames: int = 0
    windows: tuple[Floats32, ...] = ()
    places: tuple[Floats, ...] = ()
    hidden: Cells = field(default_factory=lambda: ALL_SEEN)


@dataclass(frozen=True, slots=True, eq=False)
class Appearance:
    """How the target looked in the last frame: best agreement of its cells (cells,) shortly before and when that was;
    what was `expected` of it (pixels,); cells that are hidden, and these with their edge (cells,); `carried` (2,) px:
    what is left of the step that new pictures would have made.
    """

    lately: tuple[Floats, int]
    expected: Floats32 | None = None
    hidden: Cells = field(default_factory=lambda: ALL_SEEN)
    doubtful: Cells = field(default_factory=lambda: ALL_SEEN)
    carried: Floats = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrameState:
    """Key frames, their places and their pictures together; the number of the one in use.

    health: last strengths with it. last: the last frame that showed all of the target, its place (2,) px and variances
    (2,) px². recent: the last two places. since_ns: when something came in front. likeness: to the pictures, when that
    was first looked at behind it. frames, made: how many frames and key frames there have been.
    """

    keys: tuple[KeyFrame, ...]
    chain: Chain
    appearance: Appearance
    overlap: Overlap | None = field(default_factory=lambda: Overlap(0, new=False))
    pictures: Pictures | None = None
    current: int = 0
    health: tuple[float, ...] = ()
    last: tuple[Frame, Floats, Floats] | None = None
    recent: tuple[Floats, ...] = ()
    since_ns: int | None = None
    likeness: float = 0.0
    frames: int = 0
    made: int = 1

    @property
    def key(self) -> KeyFrame:
        """The key frame in use."""
        return self.keys[self.current]

    def with_key(self, number: int, **changes: Any) -> "KeyFrameState":
        """With fields of one key frame changed."""
        keys = list(self.keys)
        keys[number] = replace(keys[number], **changes)
        return replace(self, keys=tuple(keys))

    def counted(self, number: int, strength: float) -> "KeyFrameState":
        """With one more strength of a key frame, as long as its usual one is not known."""
        known = self.keys[number].strengths
        return self if len(known) >= STRENGTH_FRAMES else self.with_key(number, strengths=(*known, strength))

    def plus(self, key: KeyFrame, place: Floats, variance: Floats) -> "KeyFrameState":
        """With one more key frame, its target at `place` (2,) px, known to a variance (2,) in px²."""
        return replace(self, keys=(*self.keys, key), chain=self.chain.extended(place, variance))

    def without(self, number: int) -> "KeyFrameState":
        """Without a key frame; numbers above it move down."""
        keys = self.keys[:number] + self.keys[number + 1 :]
        current = self.current - (self.current > number)
        chain = self.chain.without(number)
        return replace(self, keys=keys, chain=chain, current=current, overlap=None, pictures=pictures_of(keys))

    def using(self, number: int) -> "KeyFrameState":
        """With another key frame in use."""
        return replace(self, current=number, health=(), overlap=None)

    def handed_over(self, floor_px: float, unmixed_px: float) -> tuple["KeyFrameState", bool]:
        """With the picture that the overlap made, all of them aligned; False: a new key frame was not tracked and goes.

        floor_px, unmixed_px: see `realigned`.
        """
        lap = self.overlap
        if lap is None:
            return self, False
        share = clear_share(lap.windows)
        state = replace(self, overlap=None).with_key(lap.to, clear=share >= CLEAR)
        if lap.new:
            few = len(lap.windows if lap.hidden.any() else lap.places) < MIN_PAIRS
            if few or share < MIN_CLEAR:
                return state.without(lap.to), False
            place = np.mean(lap.places, axis=0) if lap.places else state.chain.place[lap.to]
            chain = state.chain.changed(lap.to, place, state.chain.variance(lap.to))
            state = replace(state, chain=chain, made=state.made + 1)
        if not lap.windows or share < MIN_CLEAR:
            return state, True
        picture: Floats32 = np.asarray(np.mean(lap.windows, axis=0, dtype=np.float32))
        state = state.with_key(lap.to, picture=picture, hidden=lap.hidden)
        keys, chain = realigned(state.keys, state.chain, floor_px, unmixed_px)
        looks = replace(state.appearance, expected=inside(picture))
        likeness = -1.0 if lap.hidden.any() else 0.0
        return replace(
            state, keys=keys, chain=chain, pictures=pictures_of(keys), appearance=looks, likeness=likeness
        ), True
