"""Key frames: reference frames that overlap, stay in use together, and lead back to the first.

A new key frame begins early, while the old one still matches well, and takes over as the one that the target is looked
for with. Once there are two, the translation is measured against all of them at once: each is a picture of the target
under its light, and a frame under another light is nearly a mix of them (`light`). Where the pictures lie to each other
follows from the same thought (`alignment`), anew with each that is added. Now and then earlier key frames are tried,
the first among them, and used again where they match again.

Something in front of the target is no light: it hides cells of it from one frame to the next (`cover`). While it is
there the target is measured by the rest; where light goes on changing, key frames are made of the rest alone.
"""

import math
from dataclasses import replace
from statistics import fmean

import numpy as np

from midspan.errors import UsageError
from midspan.records import Event, Floats, Frame, PixelTranslation, Prediction, Status
from midspan.vision.reference.cover import completed, likeness
from midspan.vision.reference.keys import KeyFrameSettings as KeyFrameSettings
from midspan.vision.reference.light import Sight, inside, placed, sight
from midspan.vision.reference.pictures import LEAST_SHOWN
from midspan.vision.reference.records import (
    Overlap,
    Seen,
    contrast,
    exchanged,
    nearest,
    unmoved,
)
from midspan.vision.reference.seeing import HEALTH_FRAMES, SeeingKeyFrames, Told
from midspan.vision.region import check_size
from midspan.vision.target import lost

USUAL_FRAMES = 5  # frames after a key frame whose strength is its usual one
REACH_SHARE = 0.1  # of the region's side: how sure the last place is for a tracker that is new to the frame
ANYWHERE_TURNS = 20  # every so many tries the first frame is looked for everywhere
CLEARER = 1.5  # times the contrast of a key frame that is mostly noise: time for another
LEAST_SEEN = 0.35  # share of the target that must be seen to learn from it
TURNED = 0.8  # share of the usual strength below which temperatures are looked at with bright and dark exchanged
EXCHANGED_TURNS = 4  # every so many tries it is the first frame with bright and dark exchanged
KNOWN_PX = 0.02  # a key frame known so well need not be found again
COVERED = 0.03  # share of the target covered from which nothing is learnt
LINK_PX = 0.5  # how well a frame's place must be known to go on from it without overlap
LINK_FRAMES = 5  # frames that may have been lost since


class KeyFrameTracker(SeeingKeyFrames):
    """Follows a target through changing light; see `midspan.vision.tracker.Tracker` for its interface.

    Its events tell of key frames, of returns, and of things that come in front of the target and go.
    """

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) since the first frame in `frame`; LOST with NaN where no key frame is found."""
        check_size(frame, self.reference)
        found = self._tracked(frame, prediction)
        events, self._events = tuple(self._events), []
        if found.status is not Status.TRACKING:
            return lost(frame.time_ns, events)
        strength = self._health[-1] if self._health else self._keys[self._current].usual
        own_x, own_y = (float(v) for v in self._own)
        return replace(
            found,
            variance_x_px2=own_x,
            variance_y_px2=own_y,
            reference_variance_x_px2=max(found.variance_x_px2 - own_x, 0.0),
            reference_variance_y_px2=max(found.variance_y_px2 - own_y, 0.0),
            strength=strength if math.isfinite(strength) else 0.0,
            events=events,
        )

    def _tracked(self, frame: Frame, prediction: Prediction | None) -> PixelTranslation:
        """The translation in `frame` whose variances hold all there is."""
        self._frames += 1
        told = self._remembered(frame, prediction, front=False) if self._hidden.any() else None
        told = told or self._result(frame, self._look(self._current, frame, prediction))
        told = told or self._remembered(frame, prediction, front=True)
        told = self._turned(frame, prediction, 0.0 if told is None else told[2]) or told
        if told is None:
            self._ended_early()
            told = self._recovered(frame, prediction) or self._remembered(frame, prediction, front=False)
        if told is None:
            self._recent, self._lately = [], (self._lately[0], frame.time_ns)
            return lost(frame.time_ns)
        result, view, strength_now = told
        self._front(frame)
        place = np.array([result.x_px, result.y_px])
        if frame.covered > COVERED:
            self._recent = [*self._recent, place][-2:]
            return result
        if not self._hidden.any():
            self._counted(strength_now)
            self._last = (frame, place, np.array([result.variance_x_px2, result.variance_y_px2]))
        self._compare(frame, result, view)
        self._recent = [*self._recent, place][-2:]
        return result

    def _counted(self, strength_now: float) -> None:
        """The strength of a frame that shows all of the target."""
        key = self._keys[self._current]
        if len(key.strengths) < USUAL_FRAMES:
            key.strengths.append(strength_now)
        self._health = [*self._health, strength_now][-HEALTH_FRAMES:]

    def _front(self, frame: Frame) -> None:
        """Tell when something comes in front of the target and when it has gone; nothing is learnt meanwhile."""
        share = float(self._hidden.mean())
        if share > 0.0 and self._since_ns is None:
            self._since_ns = frame.time_ns
            text = f"something in front of the target hides {100.0 * share:.0f} % of it"
            self._events.append(Event(frame.time_ns, "hidden", text))
            if self._overlap is not None:
                self._finish(self._overlap, frame)
        elif share == 0.0 and self._since_ns is not None:
            text = f"all of the target is seen again after {(frame.time_ns - self._since_ns) / 1e9:.1f} s"
            self._events.append(Event(frame.time_ns, "seen", text))
            self._since_ns = None

    def _recovered(self, frame: Frame, prediction: Prediction | None) -> Told | None:
        """The frame by another key frame, else by the last one that was tracked, which then becomes one."""
        if prediction is None and self._last is not None:
            x, y = (float(v) for v in self._last[1])
            reach = REACH_SHARE * min(self.region.width, self.region.height)
            prediction = Prediction(x, y, reach, reach)
        for number in nearest(self._current, self._keys, self.settings.related):
            told = self._tried_on(number, frame, self._afresh(number, frame, prediction))
            if told is not None:
                self._switch(number, frame, "the key frame in use was lost")
                return told
        if self._last is None or self._hidden.any() or self._last[0] is self._keys[self._current].frame:
            return None
        before, place, variance = self._last
        if frame.covered > COVERED or variance.max() > LINK_PX**2 or frame.index - before.index > LINK_FRAMES:
            return None
        try:
            number = self._added(before, place, variance + self.settings.link_floor_px**2)
        except UsageError:
            return None
        told = self._tried_on(number, frame, self._look(number, frame, prediction))
        if told is None:
            self._dropped(number)
            return None
        self._made += 1
        self._switch(number, frame, "new key frame without overlap: the one in use was lost")
        self._overlap = Overlap(number, new=False)
        return told

    def _turned(self, frame: Frame, prediction: Prediction | None, strength_now: float) -> Told | None:
        """The result by temperatures with bright and dark exchanged, where these fit better, as a new key frame.

        What was warmer than the rest by day may be colder by night.
        """
        if (
            not self.settings.heat
            or frame.covered > COVERED
            or strength_now >= TURNED * self._keys[self._current].usual
        ):
            return None
        other = exchanged(frame)
        numbers = [self._current, *nearest(self._current, self._keys, self.settings.related)]
        best, found = strength_now, None
        for number in numbers if strength_now == 0.0 else numbers[:1]:
            seen = self._aside(number, other, prediction)
            near = self._near(self._chain.place[number] + seen.place, prediction)
            if seen.found.status is Status.TRACKING and seen.strength > best and near:
                best, found = seen.strength, (number, seen)
        return None if found is None else self._adopted(*found, frame)

    def _adopted(self, number: int, seen: Seen, frame: Frame) -> Told | None:
        """A new key frame where an earlier one was `seen` with bright and dark exchanged."""
        variance = self._chain.variance(number) + seen.variance + self.settings.link_floor_px**2
        self._ended_early()
        try:
            new = self._added(frame, self._chain.place[number] + seen.place, variance)
        except UsageError:
            return None
        told = self._tried_on(new, frame, unmoved(frame))
        if told is None:
            self._dropped(new)
            return None
        self._made += 1
        self._switch(new, frame, "bright and dark have changed places")
        self._overlap = Overlap(new, new=False)
        return told

    def _compare(self, frame: Frame, result: PixelTranslation, view: Sight | None) -> None:
        """Go on with an overlap, or begin one with a new key frame; without one, try an earlier key frame."""
        here = Prediction(result.x_px, result.y_px, 1.0, 1.0)
        place = np.array([result.x_px, result.y_px])
        if self._overlap is None:
            self._overlap = self._begun(frame, result, self._paled(frame, view, place))
            view = view or (sight(frame.pixels, self.region, place) if self._overlap else None)
        lap = self._overlap
        if lap is None:
            if not self._hidden.any():
                self._tried(frame, here)
            return
        lap.frames += 1
        window = None if view is None else view.window(place)
        if window is not None:
            if self._hidden.any() and self._pictures is not None and self._expected is not None:
                window = completed(window, self._expected, self._pictures.mix.cell, self._doubtful)
                lap.hidden = lap.hidden | self._doubtful
            lap.windows.append(window)
        if lap.new and not lap.hidden.any():
            key = self._keys[lap.to]
            target = unmoved(frame) if frame is key.frame else self._look(lap.to, frame, here)
            if target.found.status is Status.TRACKING:
                lap.places.append(place - target.place)
                if frame is not key.frame and len(key.strengths) < USUAL_FRAMES:
                    key.strengths.append(target.strength)
        if lap.frames >= self.settings.overlap_frames:
            self._finish(lap, frame)
            again = (
                placed(self._pictures.mix, view, place) if self._pictures and self._pictures.several and view else None
            )
            self._carried = self._carried if again is None else place - again.place

    def _paled(self, frame: Frame, view: Sight | None, place: Floats) -> bool:
        """Whether light has changed the target: by the strength or, where something stands in front, by the rest."""
        usual = self._keys[self._current].usual
        share = fmean(self._health) / usual if self._health and usual > 0.0 else 1.0
        if not self._hidden.any() or self._pictures is None:
            self._likeness = 0.0
            return share < self.settings.renew_share or self._cleared(frame)
        window = None if view is None else view.window(place)
        seen_share = float(np.mean(~self._hidden)), float(np.mean(~self._doubtful))
        if window is None or seen_share[0] < LEAST_SEEN or seen_share[1] < LEAST_SHOWN:
            return False
        alike = likeness(self._pictures.mix, inside(window), self._doubtful)
        if self._likeness == 0.0:
            self._likeness = min(alike / max(share, self.settings.renew_share), 1.0)
        elif self._likeness < 0.0:
            self._likeness = alike
        # The middle cell loses three quarters of what the whole loses.
        return alike < (1.0 - 0.75 * (1.0 - self.settings.renew_share)) * self._likeness

    def _cleared(self, frame: Frame) -> bool:
        """Whether the target stands out much better than in the key frame, which is mostly noise."""
        key = self._keys[self._current]
        return not key.clear and contrast(frame, self.region_now) > CLEARER * key.contrast

    def _begun(self, frame: Frame, result: PixelTranslation, paled: bool) -> Overlap | None:
        """A new key frame where light has changed the target."""
        if not paled:
            return None if self._keys[self._current].picture is not None else Overlap(self._current, new=False)
        variance = np.array([result.variance_x_px2, result.variance_y_px2])
        try:
            number = self._added(frame, np.array([result.x_px, result.y_px]), variance)
        except UsageError:  # too little texture is left for a reference
            return None
        return Overlap(number, new=True, hidden=self._doubtful)

    def _tried(self, frame: Frame, here: Prediction) -> None:
        """Now and then: back to an earlier key frame that is better known and matches again."""
        if self._current == 0 or self._frames % self.settings.try_every:
            return
        turn = self._frames // self.settings.try_every
        if self.settings.heat and turn % EXCHANGED_TURNS == 0:
            self._tried_exchanged(frame, here)
            return
        anywhere = turn % ANYWHERE_TURNS == 0
        # Every other try is for the first frame, the rest for the others in turn.
        number = 0 if turn % 2 == 0 else (turn // 2) % len(self._keys)
        if self._keys[number].hidden.any() or (self._unlike(number) and not anywhere):
            return
        if self._chain.variance(number).sum() >= self._chain.variance(self._current).sum():
            return
        tried = self._afresh(number, frame, None if anywhere else here)
        usual = self._keys[number].usual
        if tried.found.status is not Status.TRACKING or tried.strength < self.settings.return_share * usual:
            return
        off = float(np.abs(self._chain.place[number] + tried.place - np.array([here.x_px, here.y_px])).max())
        if off < 1.0:
            self._switch(number, frame, "back to the first frame" if number == 0 else "back to an earlier key frame")
        elif number == 0:
            self._begun_again(frame, off)

    def _tried_exchanged(self, frame: Frame, here: Prediction) -> None:
        """Back to what the first frame says with bright and dark exchanged, where that matches and is better known."""
        seen = self._aside(0, exchanged(frame), here)
        known = self._chain.variance(self._current)
        strong = seen.strength >= self.settings.return_share * self._keys[0].usual
        if seen.found.status is Status.TRACKING and strong and (known > 4.0 * seen.variance + KNOWN_PX**2).any():
            self._adopted(0, seen, frame)

    def _begun_again(self, frame: Frame, off_px: float) -> None:
        """Back to the first frame, which contradicts all later key frames."""
        count = len(self._keys) - 1
        self._current = 0
        for number in range(count, 0, -1):
            self._dropped(number)
        self._health, self._recent, self._carried = [], [], np.zeros(2)
        picture = self._keys[0].picture
        self._expected = None if picture is None else inside(picture)
        text = f"back to the first frame; {count} later key frames lay {off_px:.1f} px off and are dropped"
        self._events.append(Event(frame.time_ns, "reference", text))

    def _unlike(self, number: int) -> bool:
        """Whether a key frame's picture shows that it cannot match again."""
        known, expected = self._pictures, self._expected
        if known is None or expected is None or number not in known.numbers:
            return False
        picture = known.mix.pictures[known.numbers.index(number)]
        return float(picture @ expected) < self.settings.renew_share * float(np.linalg.norm(expected))

    def _finish(self, lap: Overlap, frame: Frame) -> None:
        """Keep what an overlap gave, and hand over to a new key frame that shows all of the target."""
        if not self._kept(lap) or not lap.new:
            return
        if not lap.hidden.any():
            self._switch(lap.to, frame, "new key frame")
            return
        text = f"new key frame of the {100.0 * np.mean(~lap.hidden):.0f} % of the target that are seen"
        self._events.append(Event(frame.time_ns, "reference", text))

    def _ended_early(self) -> None:
        """The key frame in use was lost during an overlap: keep a new one if it has been tracked."""
        if self._overlap is not None:
            self._kept(self._overlap)
