"""Key frames: reference frames that overlap, stay in use together, and lead back to the first.

A new key frame begins early, while the old one still matches well, and takes over as the one that the target is looked
for with. Once there are two, the translation is measured against all of them at once: each is a picture of the target
under its light, and a frame under another light is nearly a mix of them (`light`). Where the pictures lie to each other
follows from the same thought (`pictures`), anew with each that is added. Now and then earlier key frames are tried,
the first among them, and used again where they match again.

Something in front of the target is no light: it hides cells of it from one frame to the next (`cover`). While it is
there the target is measured by the rest; where light goes on changing, key frames are made of the rest alone.
"""

import math
from dataclasses import replace

import numpy as np

from midspan.errors import UsageError
from midspan.records import Event, Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.reference.cover import LATELY, completed
from midspan.vision.reference.light import Sight, inside, placed, sight
from midspan.vision.reference.policy import (
    NEAR_PX,
    KeyFrameSettings,
    cleared,
    near,
    paled,
    to_try,
)
from midspan.vision.reference.records import (
    InnerTrackers,
    crowded,
    exchanged,
    first_chain,
    nearest,
    place_of,
    relative,
    unmoved,
    variance_of,
)
from midspan.vision.reference.seeing import Reported, measured
from midspan.vision.reference.state import STRENGTH_FRAMES, Appearance, KeyFrameState, Overlap
from midspan.vision.region import check_size, clamp, shift
from midspan.vision.target import lost
from midspan.vision.tracker import Tracker

REACH_SHARE = 0.1  # of the region's side: how sure the last place is for a tracker that is new to the frame
TURNED = 0.8  # share of the usual strength below which temperatures are looked at with bright and dark exchanged
EXCHANGED_TURNS = 4  # every this many tries it is the first frame with bright and dark exchanged
COVERED = 0.03  # share of the target covered from which nothing is learned
LINK_PX = 0.5  # how well a frame's place must be known to go on from it without overlap
LINK_FRAMES = 5  # frames that may have been lost since


class KeyFrameTracker(Tracker):
    """Follows a target through changing light; see `midspan.vision.tracker.Tracker` for its interface.

    Its events tell of key frames, of returns, and of things that come in front of the target and go. The trackers
    inside are opened once for each key frame; all that changes is in the state.
    """

    _state: KeyFrameState

    def __init__(self, reference: Frame, region: Region, settings: KeyFrameSettings | None = None) -> None:
        super().__init__(reference, region)
        self.settings = settings or KeyFrameSettings()
        self._inside = InnerTrackers(self.settings.tracker, self.settings.tracker_settings)
        self._events: list[Event] = []
        first = self._inside.key(reference, region)
        self._state = KeyFrameState((first,), first_chain(), Appearance((LATELY, reference.time_ns)))

    @property
    def region_now(self) -> Region:
        """Where the target was last seen, inside the image."""
        return self._inside.region_now(self._state.key)

    @property
    def key_frames(self) -> int:
        """How many key frames have been made, the first one counted."""
        return self._state.made

    def restore(self, state: KeyFrameState) -> None:
        """Continue from a `state` taken earlier."""
        self._state = state
        self._inside.keep(state.keys)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) since the first frame in `frame`; LOST with NaN where no key frame is found."""
        check_size(frame, self.reference)
        self._events = []
        self._state = replace(self._state, frames=self._state.frames + 1)
        reported = self._found(frame, prediction)
        if reported is None:
            looks = replace(self._state.appearance, lately=(self._state.appearance.lately[0], frame.time_ns))
            self._state = replace(self._state, recent=(), appearance=looks)
            return lost(frame.time_ns, tuple(self._events))
        found, view = reported
        self._front(frame)
        place = place_of(found)
        if frame.covered <= COVERED:
            self._counted(frame, found)
            self._compare(frame, found, view)
        state = self._state = replace(self._state, recent=(*self._state.recent, place)[-2:])
        strength = state.health[-1] if state.health else state.key.usual
        return replace(found, strength=strength, events=tuple(self._events))

    def _found(self, frame: Frame, prediction: Prediction | None) -> Reported | None:
        """The result by the key frame in use, by where the target must be, or by another key frame."""
        number = self._state.current
        reported = self._remembered(frame, prediction, front=False) if self._state.appearance.hidden.any() else None
        reported = reported or self._measured(number, frame, self._look(number, frame, prediction))
        reported = reported or self._remembered(frame, prediction, front=True)
        reported = self._turned(frame, prediction, 0.0 if reported is None else reported[0].strength) or reported
        if reported is None:
            self._hand_over()
            reported = self._recovered(frame, prediction) or self._remembered(frame, prediction, front=False)
        return reported

    def _look(
        self, number: int, frame: Frame, prediction: Prediction | None, *, afresh: bool = False
    ) -> PixelTranslation:
        """What a key frame says; `prediction` counts from the first frame. afresh: one that has not been tracked
        lately, whose memory of the motion is old.
        """
        x, y = (float(v) for v in self._state.chain.place[number])
        expected = relative(prediction, x, y)
        found, inner = self._inside.look(self._state.keys[number], frame, expected, afresh=afresh)
        self._state = self._state.with_key(number, inner=inner)
        return found

    def _aside(self, number: int, frame: Frame, prediction: Prediction | None) -> PixelTranslation:
        """What a key frame says of another picture, without a trace in the state."""
        before = self._state
        found = self._look(number, frame, prediction, afresh=True)
        self._state = before
        return found

    def _measured(
        self, number: int, frame: Frame, found: PixelTranslation, *, remembered: bool = False
    ) -> Reported | None:
        """The result of what the key frame `number` says, see `measured`."""
        looks, reported = measured(self._state, self.settings, frame, (number, found), remembered=remembered)
        self._state = replace(self._state, appearance=looks)
        return reported

    def _remembered(self, frame: Frame, prediction: Prediction | None, *, front: bool) -> Reported | None:
        """The result from where the target must be by now, where its key frame does not find it; `front`: only if
        something stands in front.
        """
        recent = self._state.recent
        if not recent or self._state.pictures is None or self.settings.heat:
            return None
        if prediction is not None:
            return self._remembered_at(frame, np.array([prediction.x_px, prediction.y_px]), front=front)
        onward = 2.0 * recent[-1] - recent[0]  # as far as before; the last place itself where there is no other
        reported = self._remembered_at(frame, onward, front=front)
        return reported or (self._remembered_at(frame, recent[-1], front=front) if len(recent) > 1 else None)

    def _remembered_at(self, frame: Frame, place: Floats, *, front: bool) -> Reported | None:
        """The result with the target looked for at `place` (2,) px from the first frame."""
        number, looks = self._state.current, self._state.appearance
        x, y = (float(v) for v in place)
        seen = self._look(number, frame, Prediction(x, y, 1.0, 1.0))
        since = place - self._state.chain.place[number]
        lost_it = seen.status is not Status.TRACKING or float(np.abs(place_of(seen) - since).max()) > NEAR_PX
        # The key frame may follow what stands in front: it only says how strong the target is.
        unsure, strength = self.settings.light_px**2, 0.0 if lost_it else seen.strength
        x, y = (float(v) for v in since)
        found = PixelTranslation(frame.time_ns, x, y, unsure, unsure, seen.quality, Status.TRACKING, strength=strength)
        reported = self._measured(number, frame, found, remembered=True)
        if reported is None or (front and not self._state.appearance.hidden.any()):
            self._state = replace(self._state, appearance=looks)
            return None
        return reported

    def _counted(self, frame: Frame, found: PixelTranslation) -> None:
        """Remember a frame that shows all of the target, and its strength; the key frame itself has none."""
        if self._state.appearance.hidden.any():
            return
        self._state = replace(self._state, last=(frame, place_of(found), variance_of(found)))
        if math.isfinite(found.strength):
            self._state = self._state.counted(self._state.current, found.strength)
            self._state = replace(self._state, health=(*self._state.health, found.strength)[-STRENGTH_FRAMES:])

    def _front(self, frame: Frame) -> None:
        """Tell when something comes in front of the target and when it has gone; nothing is learned meanwhile."""
        share, since_ns = float(self._state.appearance.hidden.mean()), self._state.since_ns
        if share > 0.0 and since_ns is None:
            self._state = replace(self._state, since_ns=frame.time_ns)
            self._tell(frame, f"{100.0 * share:.0f} % of the target is occluded", "hidden")
            self._finish(frame)
        elif share == 0.0 and since_ns is not None:
            self._tell(
                frame, (f"the whole target is visible again after {(frame.time_ns - since_ns) / 1e9:.1f} s"), "seen"
            )
            self._state = replace(self._state, since_ns=None)

    def _recovered(self, frame: Frame, prediction: Prediction | None) -> Reported | None:
        """The frame by another key frame, else by the last one that was tracked, which then becomes one."""
        last = self._state.last
        if prediction is None and last is not None:
            x, y = (float(v) for v in last[1])
            reach = REACH_SHARE * min(self.region.width, self.region.height)
            prediction = Prediction(x, y, reach, reach)
        for number in nearest(self._state.current, self._state.keys, self.settings.related):
            reported = self._measured(number, frame, self._look(number, frame, prediction, afresh=True))
            if reported is not None:
                self._switch(number, frame, "the key frame in use was lost")
                return reported
        hidden = self._state.appearance.hidden.any()
        if last is None or hidden or last[0].time_ns == self._state.key.frame.time_ns:
            return None
        before, place, variance = last
        if frame.covered > COVERED or variance.max() > LINK_PX**2 or frame.index - before.index > LINK_FRAMES:
            return None
        new = self._added(before, place, variance + self.settings.link_floor_px**2)
        why = "new key frame without overlap: the one in use was lost"
        return None if new is None else self._linked(new, frame, self._look(new, frame, prediction), why)

    def _linked(self, number: int, frame: Frame, found: PixelTranslation, why: str) -> Reported | None:
        """The result by a new key frame that takes over at once; without one it goes again."""
        reported = self._measured(number, frame, found)
        if reported is None:
            self._state = self._state.without(number)
            return None
        self._state = replace(self._state, made=self._state.made + 1)
        self._switch(number, frame, why)
        self._state = replace(self._state, overlap=Overlap(number, new=False))
        return reported

    def _turned(self, frame: Frame, prediction: Prediction | None, strength_now: float) -> Reported | None:
        """The result by temperatures with bright and dark exchanged, where these fit better, as a new key frame.

        What was warmer than the rest by day may be colder by night.
        """
        state = self._state
        if not self.settings.heat or frame.covered > COVERED or strength_now >= TURNED * state.key.usual:
            return None
        other = exchanged(frame)
        numbers = [state.current, *nearest(state.current, state.keys, self.settings.related)]
        best, found = strength_now, None
        for number in numbers if strength_now == 0.0 else numbers[:1]:
            seen = self._aside(number, other, prediction)
            likely = near(state.chain.place[number] + place_of(seen), prediction, state)
            if seen.status is Status.TRACKING and seen.strength > best and likely:
                best, found = seen.strength, (number, seen)
        return None if found is None else self._adopted(*found, frame)

    def _adopted(self, number: int, seen: PixelTranslation, frame: Frame) -> Reported | None:
        """A new key frame where an earlier one was `seen` with bright and dark exchanged."""
        chain = self._state.chain
        place, variance = chain.place[number] + place_of(seen), chain.variance(number) + variance_of(seen)
        self._hand_over()
        new = self._added(frame, place, variance + self.settings.link_floor_px**2)
        return None if new is None else self._linked(new, frame, unmoved(frame), "bright and dark are inverted")

    def _compare(self, frame: Frame, found: PixelTranslation, view: Sight | None) -> None:
        """Go on with an overlap, or begin one with a new key frame; without one, try an earlier key frame."""
        place = place_of(found)
        if self._state.overlap is None:
            self._begin(frame, found, view)
            view = view or (sight(frame.pixels, self.region, place) if self._state.overlap else None)
        lap = self._state.overlap
        if lap is None:
            if not self._state.appearance.hidden.any():
                self._tried(frame, Prediction(found.x_px, found.y_px, 1.0, 1.0))
            return
        lap = self._tracked_along(self._with_window(lap, view, place), frame, place)
        self._state = replace(self._state, overlap=lap)
        if lap.frames >= self.settings.overlap_frames:
            self._finish(frame)
            known = self._state.pictures
            again = placed(known.mix, view, place) if known and known.several and view else None
            if again is not None:
                looks = replace(self._state.appearance, carried=place - again.place)
                self._state = replace(self._state, appearance=looks)

    def _with_window(self, lap: Overlap, view: Sight | None, place: Floats) -> Overlap:
        """The overlap with one more frame; what something hides is taken from what was expected there."""
        lap = replace(lap, frames=lap.frames + 1)
        window = None if view is None else view.window(place)
        if window is None:
            return lap
        looks, known = self._state.appearance, self._state.pictures
        if looks.hidden.any() and known is not None and looks.expected is not None:
            window = completed(window, looks.expected, known.mix.cell, looks.doubtful)
            lap = replace(lap, hidden=lap.hidden | looks.doubtful)
        return replace(lap, windows=(*lap.windows, window))

    def _tracked_along(self, lap: Overlap, frame: Frame, place: Floats) -> Overlap:
        """The overlap with where a new key frame lies by this frame, in which the target is at `place` (2,) px."""
        if not lap.new or lap.hidden.any():
            return lap
        if lap.frames == 1:
            return replace(lap, places=(place,))
        x, y = (float(v) for v in place)
        seen = self._look(lap.to, frame, Prediction(x, y, 1.0, 1.0))
        if seen.status is not Status.TRACKING:
            return lap
        self._state = self._state.counted(lap.to, seen.strength)
        return replace(lap, places=(*lap.places, place - place_of(seen)))

    def _begin(self, frame: Frame, found: PixelTranslation, view: Sight | None) -> None:
        """Begin a new key frame where light has changed the target, else the picture of the one in use."""
        place = place_of(found)
        clear = cleared(self._state, frame, self.region_now)
        faded, likeness = paled(self._state, self.settings.renew_share, view, place, cleared=clear)
        self._state = replace(self._state, likeness=likeness)
        if not faded:
            lap = None if self._state.key.picture is not None else Overlap(self._state.current, new=False)
            self._state = replace(self._state, overlap=lap)
            return
        number = self._added(frame, place, variance_of(found))
        if number is not None:
            lap = Overlap(number, new=True, hidden=self._state.appearance.doubtful)
            self._state = replace(self._state, overlap=lap)

    def _tried(self, frame: Frame, here: Prediction) -> None:
        """Now and then: back to an earlier key frame that is better known and matches again."""
        state = self._state
        if state.current == 0 or state.frames % self.settings.try_every:
            return
        if self.settings.heat and state.frames // self.settings.try_every % EXCHANGED_TURNS == 0:
            self._tried_exchanged(frame, here)
            return
        chosen = to_try(state, self.settings)
        if chosen is None:
            return
        number, anywhere = chosen
        tried = self._look(number, frame, None if anywhere else here, afresh=True)
        if tried.status is not Status.TRACKING or not self._as_strong(number, tried):
            return
        off = float(np.abs(state.chain.place[number] + place_of(tried) - np.array([here.x_px, here.y_px])).max())
        if off < 1.0:
            self._switch(number, frame, "back to the first frame" if number == 0 else "back to an earlier key frame")
        elif number == 0:
            self._begun_again(frame, off)

    def _as_strong(self, number: int, found: PixelTranslation) -> bool:
        """Whether a key frame matches again."""
        return found.strength >= self.settings.return_share * self._state.keys[number].usual

    def _tried_exchanged(self, frame: Frame, here: Prediction) -> None:
        """Back to what the first frame says with bright and dark exchanged, where that matches and is better known."""
        seen = self._aside(0, exchanged(frame), here)
        # One that is known as well as any can be need not be found again.
        least = self.settings.link_floor_px**2
        better = self._state.chain.variance(self._state.current) > 4.0 * variance_of(seen) + least
        if seen.status is Status.TRACKING and self._as_strong(0, seen) and better.any():
            self._adopted(0, seen, frame)

    def _begun_again(self, frame: Frame, off_px: float) -> None:
        """Back to the first frame, which contradicts all later key frames."""
        count = len(self._state.keys) - 1
        state = self._state.using(0)
        for number in range(count, 0, -1):
            state = state.without(number)
        expected = None if state.key.picture is None else inside(state.key.picture)
        looks = replace(state.appearance, expected=expected, carried=np.zeros(2))
        self._state = replace(state, recent=(), appearance=looks)
        self._tell(frame, f"back to the first frame; {count} later key frames were {off_px:.1f} px off and are dropped")

    def _added(self, frame: Frame, place: Floats, variance: Floats) -> int | None:
        """Number of a new key frame, its target at `place` (2,) px from the first frame, with variance (2,) in px²;
        None where too little texture is left for a reference.
        """
        rows, columns = frame.pixels.shape
        try:
            key = self._inside.key(frame, clamp(shift(self.region, float(place[0]), float(place[1])), columns, rows))
        except UsageError:
            return None
        state = self._state
        if len(state.keys) >= self.settings.most:
            state = state.without(crowded(state.keys, state.current))
        self._state = state.plus(key, place, variance)
        self._inside.keep(self._state.keys)
        return len(self._state.keys) - 1

    def _hand_over(self) -> bool:
        """End an overlap; False where there was none, or a new key frame has not been tracked."""
        self._state, kept = self._state.handed_over(self.settings.link_floor_px, self.settings.unmixed_px)
        return kept

    def _finish(self, frame: Frame) -> None:
        """Keep what an overlap gave, and hand over to a new key frame that shows all of the target."""
        lap = self._state.overlap
        if not self._hand_over() or lap is None or not lap.new:
            return
        if not lap.hidden.any():
            self._switch(lap.to, frame, "new key frame")
            return
        self._tell(frame, f"new key frame from the visible {100.0 * np.mean(~lap.hidden):.0f} % of the target")

    def _switch(self, number: int, frame: Frame, why: str) -> None:
        """Use another key frame from now on."""
        state = self._state = self._state.using(number)
        spread = float(np.sqrt(state.chain.variance(number).max()))
        self._tell(frame, f"{why}: number {number} of {len(state.keys)}, position known to {spread:.3f} px")

    def _tell(self, frame: Frame, text: str, kind: str = "reference") -> None:
        self._events.append(Event(frame.time_ns, kind, text))
