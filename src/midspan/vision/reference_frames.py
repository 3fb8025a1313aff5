"""Key frames: reference frames that overlap, stay in use together, and lead back to the first.

A new key frame begins early, while the old one still matches well, and takes over as the one that the target is looked
for with. Once there are two, the translation is measured against all of them at once: each is a picture of the target
under its light, and a frame under another light is nearly a mix of them (`reference_light`). Where the pictures lie to
each other follows from the same thought (`reference_alignment`), anew with each that is added. Now and then earlier key
frames are tried, the first among them, and used again where they match again.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import option, refuse
from midspan.errors import UsageError
from midspan.records import Event, Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.reference_light import Sight, sight
from midspan.vision.reference_pictures import Pictures, pictures_of, realigned
from midspan.vision.reference_records import Chain, KeyFrame, Overlap, Seen, first_chain, unmoved
from midspan.vision.reference_strength import open_counting, relative, share_lost, strength
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
    earlier one is taken again above this share. overlap_frames: frames that make a key frame's picture and the
    hand-over to it, 3 or more. try_every: every so many frames an earlier key frame is tried. related: so many earlier
    ones are tried when the one in use is lost, 1 or more. most: key frames kept, 3 or more; memory and time are limited
    by it. link_floor_px: standard deviation of a key frame's place that nothing takes away. light_px: standard
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
    light_px: float = 0.5

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

    keys: tuple[tuple[Any, ...], ...]
    chain: Chain
    current: int
    health: tuple[float, ...]
    last: tuple[Frame, Floats, Floats] | None
    overlap: tuple[Any, ...] | None
    carried: Floats
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
        self._overlap: Overlap | None = Overlap(0, new=False)
        self._pictures: Pictures | None = None
        self._carried = np.zeros(2)
        self._frames, self._made = 0, 1
        self._events: list[Event] = []
        self._own: Floats = np.zeros(2)

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

    @property
    def own_variance_px2(self) -> tuple[float, float]:
        """Variances along x and y (px²) of the last frame alone, without those of places and of light."""
        return float(self._own[0]), float(self._own[1])

    @property
    def strength(self) -> float:
        """How well the target resembled the key frame in use in the last frame that showed it."""
        return self._health[-1] if self._health else self._keys[self._current].usual

    def take_events(self) -> list[Event]:
        """What happened since this was last called: new key frames, returns."""
        told, self._events = self._events, []
        return told

    @property
    def state(self) -> KeyFrameState:
        """Everything that changes from frame to frame."""
        lap = self._overlap
        return KeyFrameState(
            keys=tuple(
                (k.frame, k.region, k.tracker.state, tuple(k.strengths), k.picture, k.offset) for k in self._keys
            ),
            chain=self._chain,
            current=self._current,
            health=tuple(self._health),
            last=self._last,
            overlap=None if lap is None else (lap.to, lap.new, lap.frames, tuple(lap.windows), tuple(lap.places)),
            carried=self._carried,
            frames=self._frames,
            made=self._made,
        )

    def restore(self, state: KeyFrameState) -> None:
        """Continue from a `state` taken earlier."""
        known = {(id(key.frame), key.region): key for key in self._keys}
        keys = []
        for frame, region, inner, strengths, picture, offset in state.keys:
            key = known.get((id(frame), region)) or self._opened(frame, region)
            key.tracker.restore(inner)
            key.strengths, key.picture, key.offset = list(strengths), picture, offset
            keys.append(key)
        self._keys, self._chain, self._current = keys, state.chain, state.current
        self._health, self._last = list(state.health), state.last
        self._frames, self._made, self._overlap = state.frames, state.made, None
        self._carried = state.carried
        if state.overlap is not None:
            to, new, laps, windows, places = state.overlap
            self._overlap = Overlap(to, new, laps, list(windows), list(places))
        self._pictures = pictures_of(self._keys)

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
        result, view = self._result(frame, seen)
        self._compare(frame, result, view)
        self._last = (
            frame,
            np.array([result.x_px, result.y_px]),
            np.array([result.variance_x_px2, result.variance_y_px2]),
        )
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

    def _result(self, frame: Frame, seen: Seen) -> tuple[PixelTranslation, Sight | None]:
        """Translation since the first frame, by the mix of all pictures where there is one, and the frame as seen.

        Its variance holds those of the key frames' places and of what light may do.
        """
        place = self._chain.place[self._current] + seen.place
        variance = self._chain.variance(self._current) + seen.variance
        view = sight(frame.pixels, self.region, place) if self._pictures or self._overlap else None
        together = self._pictures.place(self._chain, view, place) if self._pictures and view else None
        if together is not None:
            place, variance = together
            # What a new picture corrects comes in little by little, not as a step.
            self._carried = (1.0 - 0.5 / self.settings.overlap_frames) * self._carried
            place, variance = place + self._carried, variance + self._carried**2
        self._own = seen.variance
        gone = share_lost(float(np.mean(self._health)), self._keys[self._current].usual)
        variance = variance + (self.settings.light_px * gone) ** 2
        return replace(
            seen.found,
            x_px=float(place[0]),
            y_px=float(place[1]),
            variance_x_px2=float(variance[0]),
            variance_y_px2=float(variance[1]),
        ), view

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
            number = self._added(before, place, variance + self.settings.link_floor_px**2)
        except UsageError:
            return None
        seen = self._look(number, frame, prediction)
        if seen.found.status is not Status.TRACKING:
            self._dropped(number)
            return None
        self._made += 1
        self._switch(number, frame, "new key frame without overlap: the one in use was lost")
        self._overlap = Overlap(number, new=False)
        return seen

    def _nearest(self, number: int) -> list[int]:
        """Up to `related` key frames besides one: those that were made next to it, and the first."""
        others = sorted((k for k in range(len(self._keys)) if k != number), key=lambda k: (abs(k - number), -k))
        chosen = others[: self.settings.related]
        return chosen if 0 in chosen or number == 0 else [*chosen[:-1], 0]

    def _added(self, frame: Frame, place: Floats, variance: Floats) -> int:
        """Number of a new key frame, its target at `place` (2,) px from the first frame, with variance (2,) in px²."""
        if len(self._keys) >= self.settings.most:
            self._dropped(self._crowded())
        rows, columns = frame.pixels.shape
        region = clamp(shift(self.region, float(place[0]), float(place[1])), columns, rows)
        self._keys.append(self._opened(frame, region))
        self._chain = self._chain.extended(place, variance)
        return len(self._keys) - 1

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
        self._overlap, self._pictures = None, pictures_of(self._keys)

    def _compare(self, frame: Frame, result: PixelTranslation, view: Sight | None) -> None:
        """Go on with an overlap, or begin one with a new key frame; without one, try an earlier key frame."""
        here = Prediction(result.x_px, result.y_px, 1.0, 1.0)
        place = np.array([result.x_px, result.y_px])
        if self._overlap is None:
            self._overlap = self._begun(frame, result)
            view = view or (sight(frame.pixels, self.region, place) if self._overlap else None)
        lap = self._overlap
        if lap is None:
            self._tried(frame, here)
            return
        lap.frames += 1
        window = None if view is None else view.window(place)
        if window is not None:
            lap.windows.append(window)
        if lap.new:
            key = self._keys[lap.to]
            target = unmoved(frame) if frame is key.frame else self._look(lap.to, frame, here)
            if target.found.status is Status.TRACKING:
                lap.places.append(place - target.place)
                if frame is not key.frame and len(key.strengths) < USUAL_FRAMES:
                    key.strengths.append(target.strength)
        if lap.frames >= self.settings.overlap_frames:
            self._finish(lap, frame)
            again = self._pictures.place(self._chain, view, place) if self._pictures and view else None
            self._carried = self._carried if again is None else place - again[0]

    def _begun(self, frame: Frame, result: PixelTranslation) -> Overlap | None:
        """A new key frame where the one in use has lost strength."""
        key = self._keys[self._current]
        if key.usual <= 0.0 or float(np.mean(self._health)) >= self.settings.renew_share * key.usual:
            return None
        variance = np.array([result.variance_x_px2, result.variance_y_px2])
        try:
            number = self._added(frame, np.array([result.x_px, result.y_px]), variance)
        except UsageError:  # too little texture is left for a reference
            return None
        return Overlap(number, new=True)

    def _tried(self, frame: Frame, here: Prediction) -> None:
        """Now and then: back to an earlier key frame that is better known and matches again."""
        if self._current == 0 or self._frames % self.settings.try_every:
            return
        turn = self._frames // self.settings.try_every
        # Every other try is for the first frame, the rest for the others in turn.
        number = 0 if turn % 2 == 0 else (turn // 2) % len(self._keys)
        if self._chain.variance(number).sum() >= self._chain.variance(self._current).sum():
            return
        tried = self._afresh(number, frame, here)
        if tried.found.status is not Status.TRACKING:
            return
        off = self._chain.place[number] + tried.place - np.array([here.x_px, here.y_px])
        if float(np.abs(off).max()) < 1.0 and tried.strength >= self.settings.return_share * self._keys[number].usual:
            self._switch(number, frame, "back to the first frame" if number == 0 else "back to an earlier key frame")

    def _finish(self, lap: Overlap, frame: Frame) -> None:
        """Keep what an overlap gave, and hand over to a new key frame."""
        if self._kept(lap) and lap.new:
            self._switch(lap.to, frame, "new key frame")

    def _kept(self, lap: Overlap) -> bool:
        """Keep the picture that an overlap made and align all of them; False where a new key frame was not tracked."""
        self._overlap = None
        if lap.new:
            if len(lap.places) < LEAST_PAIRS:
                self._dropped(lap.to)
                return False
            self._made += 1
            place = np.mean(lap.places, axis=0)
            self._chain = self._chain.changed(lap.to, place, self._chain.variance(lap.to))
        if lap.windows:
            self._keys[lap.to].picture = np.mean(lap.windows, axis=0, dtype=np.float32)
            self._chain = realigned(self._keys, self._chain, self.settings.link_floor_px)
            self._pictures = pictures_of(self._keys)
        return True

    def _ended_early(self) -> None:
        """The key frame in use was lost during an overlap: keep a new one if it has been tracked."""
        if self._overlap is not None:
            self._kept(self._overlap)

    def _switch(self, number: int, frame: Frame, why: str) -> None:
        """Use another key frame from now on."""
        self._current, self._health, self._overlap = number, [], None
        spread = float(np.sqrt(self._chain.variance(number).max()))
        text = f"{why}: number {number} of {len(self._keys)}, its place known to {spread:.3f} px"
        self._events.append(Event(frame.time_ns, "reference", text))
