"""The key frames of a target, where they lie, and what the tracker remembers of them from frame to frame."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from midspan.checks import option, refuse
from midspan.records import Event, Floats, Frame, Prediction, Region
from midspan.vision.reference.cover import ALL_SEEN, LATELY, Cells
from midspan.vision.reference.light import inside
from midspan.vision.reference.pictures import Pictures, pictures_of, realigned
from midspan.vision.reference.records import (
    Chain,
    KeyFrame,
    KeyFrameState,
    Overlap,
    Seen,
    clear_share,
    contrast,
    crowded,
    first_chain,
)
from midspan.vision.reference.strength import relative
from midspan.vision.region import clamp, shift
from midspan.vision.spline import Floats32
from midspan.vision.tracker import TRACKERS, Tracker, open_tracker

LEAST_PAIRS = 3
CLEAR = 0.95  # share of frames' contrast, squared, that a good key frame and they have in common
LEAST_CLEAR = 0.67  # of frames' contrast, squared, that they must have in common to make a picture: the rest is noise


@dataclass(frozen=True, slots=True)
class KeyFrameSettings:
    """How key frames are made and used.

    tracker, tracker_settings: what tracks, its own settings. renew_share: a new key frame begins when the strength
    (matches, or quality) falls below this share of the usual one, 0 to 1; more gives more key frames. return_share: an
    earlier one is taken again above this share. overlap_frames: frames that make a key frame's picture and the
    hand-over to it, 3 or more. try_every: every so many frames an earlier key frame is tried. related: so many earlier
    ones are tried when the one in use is lost, 1 or more. most: key frames kept, 3 or more; memory and time are limited
    by it. link_floor_px: standard deviation of a key frame's place that nothing takes away. light_px: standard
    deviation that the loss of all strength stands for, px. unmixed_px: standard deviation of a picture's place if
    nothing in it were a mix of others: what the shadows do that bumps throw in grazing light is a quarter of 3 px.
    heat: frames are temperatures: bright and dark may change places, and things in front, which were taken out
    before, are not looked for.
    """

    tracker: str = "template"
    tracker_settings: Any = None
    renew_share: float = 0.9
    return_share: float = 0.95
    overlap_frames: int = 10
    try_every: int = 5
    related: int = 3
    most: int = 24
    link_floor_px: float = 0.005
    light_px: float = 0.6
    unmixed_px: float = 3.0
    heat: bool = False

    def __post_init__(self) -> None:
        option("tracker", self.tracker, TRACKERS)
        if not 0.0 < self.renew_share < self.return_share <= 1.0:
            raise refuse(
                "renew_share and return_share", "above 0, rising, up to 1", (self.renew_share, self.return_share)
            )
        for name, least in (("overlap_frames", LEAST_PAIRS), ("try_every", 1), ("related", 1), ("most", 3)):
            if getattr(self, name) < least:
                raise refuse(name, f"{least} or more", getattr(self, name))
        if not (0.0 <= self.link_floor_px < math.inf and 0.0 <= self.light_px < math.inf):
            raise refuse("link_floor_px and light_px", "0 px or more", (self.link_floor_px, self.light_px))
        if not 0.0 <= self.unmixed_px < math.inf:
            raise refuse("unmixed_px", "0 px or more", self.unmixed_px)


class KeyFrames(Tracker):
    """Key frames with their trackers, pictures and places; what is common to making them and to measuring by them."""

    def __init__(self, reference: Frame, region: Region, settings: KeyFrameSettings | None = None) -> None:
        super().__init__(reference, region)
        self.settings = settings or KeyFrameSettings()
        self._keys = [self._opened(reference, region)]
        self._chain = first_chain()
        self._current = 0
        self._health: list[float] = []
        self._last: tuple[Frame, Floats, Floats] | None = None
        self._overlap: Overlap | None = Overlap(0, new=False)
        self._pictures: Pictures | None = None
        self._carried = np.zeros(2)
        self._frames, self._made = 0, 1
        self._events: list[Event] = []
        self._own: Floats = np.zeros(2)
        self._expected: Floats32 | None = None
        self._hidden: Cells = ALL_SEEN
        self._doubtful: Cells = ALL_SEEN
        self._since_ns: int | None = None
        self._likeness = 0.0
        self._lately: tuple[Floats, int] = LATELY, reference.time_ns
        self._recent: list[Floats] = []

    @property
    def region_now(self) -> Region:
        """Where the target was last seen, inside the image."""
        return self._keys[self._current].tracker.region_now

    @property
    def chain(self) -> Chain:
        """Places of the key frames in the first frame's pixels."""
        return self._chain

    @property
    def current(self) -> int:
        """Number of the key frame in use, in the chain; 0 is the first frame."""
        return self._current

    @property
    def key_frames(self) -> int:
        """How many key frames have been made, the first one counted."""
        return self._made

    @property
    def state(self) -> KeyFrameState:
        """Everything that changes from frame to frame."""
        lap = self._overlap
        return KeyFrameState(
            keys=tuple(
                (k.frame, k.region, k.tracker.state, tuple(k.strengths), k.picture, k.offset, k.hidden, k.clear)
                for k in self._keys
            ),
            chain=self._chain,
            current=self._current,
            health=tuple(self._health),
            last=self._last,
            overlap=None
            if lap is None
            else (lap.to, lap.new, lap.frames, tuple(lap.windows), tuple(lap.places), lap.hidden),
            carried=self._carried,
            expected=self._expected,
            hidden=self._hidden,
            since_ns=self._since_ns,
            likeness=self._likeness,
            lately=self._lately,
            recent=tuple(self._recent),
            doubtful=self._doubtful,
            frames=self._frames,
            made=self._made,
        )

    def restore(self, state: KeyFrameState) -> None:
        """Continue from a `state` taken earlier."""
        known = {(id(key.frame), key.region): key for key in self._keys}
        keys = []
        for frame, region, inner, strengths, picture, offset, hidden, clear in state.keys:
            key = known.get((id(frame), region)) or self._opened(frame, region)
            key.tracker.restore(inner)
            key.strengths, key.picture, key.offset, key.hidden = list(strengths), picture, offset, hidden
            key.clear = clear
            keys.append(key)
        self._keys, self._chain, self._current = keys, state.chain, state.current
        self._health, self._last = list(state.health), state.last
        self._frames, self._made, self._overlap = state.frames, state.made, None
        self._carried, self._expected = state.carried, state.expected
        self._hidden, self._since_ns = state.hidden, state.since_ns
        self._likeness, self._recent = state.likeness, list(state.recent)
        self._lately = state.lately
        self._doubtful, self._events = state.doubtful, []
        if state.overlap is not None:
            to, new, laps, windows, places, hidden = state.overlap
            self._overlap = Overlap(to, new, laps, list(windows), list(places), hidden)
        self._pictures = pictures_of(self._keys)

    def _opened(self, frame: Frame, region: Region) -> KeyFrame:
        tracker = open_tracker(self.settings.tracker, frame, region, self.settings.tracker_settings)
        return KeyFrame(frame, region, tracker, tracker.state, contrast(frame, region))

    def _look(self, number: int, frame: Frame, prediction: Prediction | None) -> Seen:
        """What the key frame says; `prediction` counts from the first frame."""
        tracker = self._keys[number].tracker
        x, y = (float(v) for v in self._chain.place[number])
        found = tracker.push(frame, relative(prediction, x, y))
        return Seen(found, found.strength)

    def _afresh(self, number: int, frame: Frame, prediction: Prediction | None) -> Seen:
        """What a key frame says that has not been tracked lately: its own memory of the motion is old."""
        self._keys[number].tracker.restore(self._keys[number].at_rest)
        return self._look(number, frame, prediction)

    def _added(self, frame: Frame, place: Floats, variance: Floats) -> int:
        """Number of a new key frame, its target at `place` (2,) px from the first frame, with variance (2,) in px²."""
        if len(self._keys) >= self.settings.most:
            self._dropped(crowded(self._keys, self._current))
        rows, columns = frame.pixels.shape
        region = clamp(shift(self.region, float(place[0]), float(place[1])), columns, rows)
        self._keys.append(self._opened(frame, region))
        self._chain = self._chain.extended(place, variance)
        return len(self._keys) - 1

    def _dropped(self, number: int) -> None:
        """Forget a key frame; numbers above it move down."""
        del self._keys[number]
        self._chain = self._chain.without(number)
        if self._current > number:
            self._current -= 1
        self._overlap, self._pictures = None, pictures_of(self._keys)

    def _kept(self, lap: Overlap) -> bool:
        """Keep the picture that an overlap made and align all of them; False where a new key frame was not tracked."""
        self._overlap = None
        share = clear_share(lap.windows)
        clear, self._keys[lap.to].clear = share >= LEAST_CLEAR, share >= CLEAR
        if lap.new:
            few = len(lap.windows if lap.hidden.any() else lap.places) < LEAST_PAIRS
            if few or not clear:
                self._dropped(lap.to)
                return False
            self._made += 1
            place = np.mean(lap.places, axis=0) if lap.places else self._chain.place[lap.to]
            self._chain = self._chain.changed(lap.to, place, self._chain.variance(lap.to))
        if lap.windows and clear:
            picture: Floats32 = np.asarray(np.mean(lap.windows, axis=0, dtype=np.float32))
            self._keys[lap.to].picture, self._keys[lap.to].hidden = picture, lap.hidden
            self._expected, self._likeness = inside(picture), -1.0 if lap.hidden.any() else 0.0
            self._chain = realigned(self._keys, self._chain, self.settings.link_floor_px, self.settings.unmixed_px)
            self._pictures = pictures_of(self._keys)
        return True

    def _switch(self, number: int, frame: Frame, why: str) -> None:
        """Use another key frame from now on."""
        self._current, self._health, self._overlap = number, [], None
        spread = float(np.sqrt(self._chain.variance(number).max()))
        text = f"{why}: number {number} of {len(self._keys)}, its place known to {spread:.3f} px"
        self._events.append(Event(frame.time_ns, "reference", text))
