"""Key frames: reference frames that overlap, are matched to several earlier ones, and lead back to the first.

A new key frame begins early, while the old one still matches well. For some frames both are tracked, and with them the
key frames before; the mean difference says where the new one lies, and the reference's own noise cancels in it. Now and
then earlier key frames are tried, the first among them: where one matches again, that closes the chain and takes back
what has added up. The variance of a measurement holds that of its key frame's place, and what lost strength stands for.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import option, refuse
from midspan.errors import UsageError
from midspan.records import Event, Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.reference_chain import Chain, Link, first_chain, mean_link, share_lost
from midspan.vision.reference_records import KeyFrame, Overlap, Seen, unmoved
from midspan.vision.reference_strength import open_counting, relative, strength
from midspan.vision.region import check_size, clamp, shift
from midspan.vision.target import lost
from midspan.vision.tracker import TRACKERS

USUAL_FRAMES = 5  # frames after a key frame whose strength is its usual one
HEALTH_FRAMES = 5  # frames that the strength is averaged over
REACH_SHARE = 0.1  # of the region's side: how sure the last place is for a tracker that is new to the frame
LEAST_PAIRS = 3


@dataclass(frozen=True, slots=True)
class KeyFrameSettings:
    """How key frames are made and used.

    tracker, tracker_settings: what tracks, its own settings. renew_share: a new key frame begins when the strength
    (matches, or quality) falls below this share of the usual one, 0 to 1; more gives more key frames. return_share: an
    earlier one is taken again above this share. overlap_frames: frames that both are tracked for, 3 or more; more makes
    the hand-over more exact. try_every: every so many frames an earlier key frame is tried. related: so many earlier
    ones are matched in an overlap, 1 or more. most: key frames kept, 3 or more; memory and time are limited by it.
    link_floor_px: standard deviation of a hand-over that a longer overlap does not take away. light_px: standard
    deviation that the loss of all strength stands for, px.
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
    light_px: float = 0.3

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


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrameState:
    """What the tracker remembers, for `restore` of a tracker of the same first frame, region and settings."""

    keys: tuple[tuple[Frame, Region, Any, tuple[float, ...]], ...]
    chain: Chain
    current: int
    health: tuple[float, ...]
    last: tuple[Frame, Floats, Floats] | None
    overlap: tuple[Any, ...] | None
    frames: int
    made: int


class KeyFrameTracker:
    """Follows a target through changing light; see `midspan.vision.tracker.Tracker` for its interface.

    `events` tells of key frames and returns since it was last read by `take_events`.
    """

    def __init__(self, reference: Frame, region: Region, settings: KeyFrameSettings | None = None) -> None:
        self.settings = settings or KeyFrameSettings()
        self._keys = [self._opened(reference, region)]
        self._chain = first_chain()
        self._current = 0
        self._health: list[float] = []
        self._last: tuple[Frame, Floats, Floats] | None = None
        self._overlap: Overlap | None = None
        self._frames, self._made = 0, 1
        self._events: list[Event] = []

    @property
    def reference(self) -> Frame:
        """The frame that the translation counts from: the first."""
        return self._keys[0].frame

    @property
    def region(self) -> Region:
        """The target's region in the first frame."""
        return self._keys[0].region

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

    def take_events(self) -> list[Event]:
        """What happened since this was last called: new key frames, returns."""
        told, self._events = self._events, []
        return told

    @property
    def state(self) -> KeyFrameState:
        """Everything that changes from frame to frame."""
        lap = self._overlap
        return KeyFrameState(
            keys=tuple((k.frame, k.region, k.tracker.state, tuple(k.strengths)) for k in self._keys),
            chain=self._chain,
            current=self._current,
            health=tuple(self._health),
            last=self._last,
            overlap=None
            if lap is None
            else (lap.to, lap.others, lap.new, lap.frames, tuple((j, tuple(pairs)) for j, pairs in lap.pairs.items())),
            frames=self._frames,
            made=self._made,
        )

    def restore(self, state: KeyFrameState) -> None:
        """Continue from a `state` taken earlier."""
        known = {(id(key.frame), key.region): key for key in self._keys}
        keys = []
        for frame, region, inner, strengths in state.keys:
            key = known.get((id(frame), region)) or self._opened(frame, region)
            key.tracker.restore(inner)
            key.strengths = list(strengths)
            keys.append(key)
        self._keys, self._chain, self._current = keys, state.chain, state.current
        self._health, self._last = list(state.health), state.last
        self._frames, self._made, self._overlap = state.frames, state.made, None
        if state.overlap is not None:
            to, others, new, frames, pairs = state.overlap
            self._overlap = Overlap(to, others, new, frames, {j: list(rows) for j, rows in pairs})

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) since the first frame in `frame`; LOST with NaN where no key frame is found."""
        check_size(frame, self.reference)
        self._frames += 1
        seen = self._look(self._current, frame, prediction)
        if seen.found.status is not Status.TRACKING:
            self._ended_early()
            seen = self._recovered(frame, prediction) or seen
        if seen.found.status is not Status.TRACKING:
            return lost(frame.time_ns)
        key = self._keys[self._current]
        if len(key.strengths) < USUAL_FRAMES:
            key.strengths.append(seen.strength)
        self._health = [*self._health, seen.strength][-HEALTH_FRAMES:]
        result = self._result(frame, seen)
        self._compare(frame, seen, self._predicted(result))
        self._last = (frame, np.array([result.x_px, result.y_px]), self._chain.variance(self._current) + seen.variance)
        return result

    def _opened(self, frame: Frame, region: Region) -> KeyFrame:
        tracker = open_counting(self.settings.tracker, frame, region, self.settings.tracker_settings)
        return KeyFrame(frame, region, tracker, tracker.state)

    def _look(self, number: int, frame: Frame, prediction: Prediction | None) -> Seen:
        """What the key frame says; `prediction` counts from the first frame."""
        tracker = self._keys[number].tracker
        x, y = (float(v) for v in self._chain.place[number])
        found = tracker.push(frame, relative(prediction, x, y))
        return Seen(found, strength(tracker, found))

    def _afresh(self, number: int, frame: Frame, prediction: Prediction | None) -> Seen:
        """What a key frame says that has not been tracked lately: its own memory of the motion is old."""
        self._keys[number].tracker.restore(self._keys[number].at_rest)
        return self._look(number, frame, prediction)

    def _predicted(self, result: PixelTranslation) -> Prediction:
        """This frame's own result as the prediction for other key frames."""
        return Prediction(result.x_px, result.y_px, 1.0, 1.0)

    def _result(self, frame: Frame, seen: Seen) -> PixelTranslation:
        """Translation since the first frame, with the variance of the key frame's place and of what light may do."""
        place = self._chain.place[self._current] + seen.place
        gone = share_lost(float(np.mean(self._health)), self._keys[self._current].usual)
        variance = self._chain.variance(self._current) + seen.variance + (self.settings.light_px * gone) ** 2
        return replace(
            seen.found,
            x_px=float(place[0]),
            y_px=float(place[1]),
            variance_x_px2=float(variance[0]),
            variance_y_px2=float(variance[1]),
        )

    def _recovered(self, frame: Frame, prediction: Prediction | None) -> Seen | None:
        """The frame by another key frame, else by the last one that was tracked, which then becomes one."""
        if prediction is None and self._last is not None:
            x, y = (float(v) for v in self._last[1])
            reach = REACH_SHARE * min(self.region.width, self.region.height)
            prediction = Prediction(x, y, reach, reach)
        for number in self._nearest(self._current):
            seen = self._afresh(number, frame, prediction)
            if seen.found.status is Status.TRACKING:
                self._switch(number, frame, "the key frame in use was lost")
                return seen
        if self._last is None or self._last[0] is self._keys[self._current].frame:
            return None
        before, place, variance = self._last
        try:
            number = self._added(before, place)
        except UsageError:
            return None
        self._chain = self._chain.linked(Link(0, number, place, variance + self.settings.link_floor_px**2))
        seen = self._look(number, frame, prediction)
        if seen.found.status is not Status.TRACKING:
            self._dropped(number)
            return None
        self._made += 1
        self._switch(number, frame, "new key frame without overlap: the one in use was lost")
        return seen

    def _nearest(self, number: int) -> list[int]:
        """Up to `related` key frames besides one: those that were made next to it, and the first."""
        others = sorted((k for k in range(len(self._keys)) if k != number), key=lambda k: (abs(k - number), -k))
        chosen = others[: self.settings.related]
        return chosen if 0 in chosen or number == 0 else [*chosen[:-1], 0]

    def _added(self, frame: Frame, place: Floats) -> int:
        """Number of a new key frame, its target at `place` (2,) px from the first frame; its place is still unknown."""
        if len(self._keys) >= self.settings.most:
            self._dropped(self._crowded())
        rows, columns = frame.pixels.shape
        region = clamp(shift(self.region, float(place[0]), float(place[1])), columns, rows)
        self._keys.append(self._opened(frame, region))
        self._chain = self._chain.extended()
        number = len(self._keys) - 1
        self._chain.place[number] = place
        return number

    def _crowded(self) -> int:
        """The key frame, not the first nor the one in use, whose neighbours in time are nearest to each other."""
        times = [key.frame.time_ns for key in self._keys]
        inner = [k for k in range(1, len(times)) if k != self._current]
        return min(inner, key=lambda k: times[min(k + 1, len(times) - 1)] - times[k - 1])

    def _dropped(self, number: int) -> None:
        """Forget a key frame; numbers above it move down."""
        del self._keys[number]
        self._chain = self._chain.without(number)
        if self._current > number:
            self._current -= 1
        self._overlap = None

    def _compare(self, frame: Frame, seen: Seen, here: Prediction) -> None:
        """Go on with an overlap, or begin one with a new key frame or an earlier one."""
        if self._overlap is None:
            self._overlap = self._begun(frame, seen, here)
        lap = self._overlap
        if lap is None:
            return
        lap.frames += 1
        target = unmoved(frame) if frame is self._keys[lap.to].frame else self._look(lap.to, frame, here)
        if target.found.status is Status.TRACKING:
            if frame is not self._keys[lap.to].frame and len(self._keys[lap.to].strengths) < USUAL_FRAMES:
                self._keys[lap.to].strengths.append(target.strength)
            for number in (self._current, *lap.others):
                other = seen if number == self._current else self._look(number, frame, here)
                if other.found.status is Status.TRACKING and self._believed(number, other, here):
                    row = (other.place - target.place, other.variance + target.variance, self._gone(number, other))
                    lap.pairs.setdefault(number, []).append(row)
        if lap.frames >= self.settings.overlap_frames:
            self._finish(lap, frame)

    def _gone(self, number: int, seen: Seen) -> float:
        return share_lost(seen.strength, self._keys[number].usual)

    def _believed(self, number: int, seen: Seen, here: Prediction) -> bool:
        """Whether a key frame still resembles the target and finds it where the one in use does."""
        if number == self._current:
            return True
        off = self._chain.place[number] + seen.place - np.array([here.x_px, here.y_px])
        near = float(np.abs(off).max()) < 1.0
        return near and seen.strength >= 0.5 * self._keys[number].usual

    def _begun(self, frame: Frame, seen: Seen, here: Prediction) -> Overlap | None:
        key = self._keys[self._current]
        if key.usual > 0.0 and float(np.mean(self._health)) < self.settings.renew_share * key.usual:
            place = np.array([here.x_px, here.y_px])
            try:
                number = self._added(frame, place)
            except UsageError:  # too little texture is left for a reference
                return None
            others = tuple(k for k in self._nearest(self._current) if k != number)
            for other in others:
                self._keys[other].tracker.restore(self._keys[other].at_rest)
            return Overlap(number, others, new=True)
        if self._current == 0 or self._frames % self.settings.try_every:
            return None
        turn = self._frames // self.settings.try_every
        # Every other try is for the first frame, the rest for the others in turn.
        number = 0 if turn % 2 == 0 else (turn // 2) % len(self._keys)
        if number == self._current:
            return None
        tried = self._afresh(number, frame, here)
        enough = self.settings.return_share * self._keys[number].usual
        if tried.found.status is Status.TRACKING and tried.strength >= enough and self._believed(number, tried, here):
            return Overlap(number, (), new=False)
        return None

    def _finish(self, lap: Overlap, frame: Frame) -> None:
        """Link what was compared, and hand over to the other key frame where it is the better one."""
        self._overlap = None
        if not self._linked(lap, LEAST_PAIRS):
            if lap.new:
                self._dropped(lap.to)
            return
        if lap.new:
            self._made += 1
            self._switch(lap.to, frame, "new key frame")
        elif self._chain.variance(lap.to).sum() <= self._chain.variance(self._current).sum():
            self._switch(lap.to, frame, "back to the first frame" if lap.to == 0 else "back to an earlier key frame")

    def _linked(self, lap: Overlap, least: int) -> bool:
        """Add the links of an overlap of `least` pairs or more; whether there is one with the key frame in use."""
        for number, rows in lap.pairs.items():
            if len(rows) >= least:
                pairs, variances, gone = (np.array([row[k] for row in rows]) for k in range(3))
                # What light does to a picture is the same in all frames of an overlap.
                floor_px = math.hypot(self.settings.link_floor_px, self.settings.light_px * float(gone.mean()))
                value, variance = mean_link(pairs, variances, floor_px)
                self._chain = self._chain.linked(Link(number, lap.to, value, variance))
        return len(lap.pairs.get(self._current, ())) >= least

    def _ended_early(self) -> None:
        """The key frame in use was lost during an overlap: keep a new one with the pairs that there are."""
        lap, self._overlap = self._overlap, None
        if lap is not None and lap.new:
            if self._linked(lap, 1):
                self._made += 1
            else:
                self._dropped(lap.to)

    def _switch(self, number: int, frame: Frame, why: str) -> None:
        """Use another key frame from now on."""
        self._current, self._health, self._overlap = number, [], None
        spread = float(np.sqrt(self._chain.variance(number).max()))
        text = f"{why}: number {number} of {len(self._keys)}, its place known to {spread:.3f} px"
        self._events.append(Event(frame.time_ns, "reference", text))
