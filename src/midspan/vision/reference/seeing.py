"""What key frames say of a frame: where the target lies by the mix of their pictures, and how well that is known."""

from dataclasses import replace
from statistics import fmean

import numpy as np

from midspan.records import Floats, Frame, PixelTranslation, Prediction, Status
from midspan.vision.reference.cover import ALL_SEEN, LATELY, PALING, Uncovered, uncovered
from midspan.vision.reference.keys import KeyFrames
from midspan.vision.reference.light import Sight, placed, sight
from midspan.vision.reference.records import Seen
from midspan.vision.reference.strength import share_lost

HEALTH_FRAMES = 5  # frames that the strength is averaged over
NEAR_PX = 1.5  # of where the target must be: what a key frame finds beyond is another thing
SCATTERED = 2.0  # standard deviations of the strength that say nothing
WEAK = 0.95  # share of the usual strength below which a single picture is looked at for a thing in front
FAR_SHARE = 0.25  # of the region's side: how far from its last place a target without prediction is believed

Told = tuple[PixelTranslation, Sight | None, float]  # a result, the frame as seen, its strength


class SeeingKeyFrames(KeyFrames):
    """Key frames that measure the translation in a frame; which of them is used, and when another is made, is not their
    matter.
    """

    def _remembered(self, frame: Frame, prediction: Prediction | None, *, front: bool) -> Told | None:
        """The result from where the target must be by now, where its key frame does not find it; `front`: only if
        something stands in front.
        """
        if not self._recent or self._pictures is None or self.settings.heat:
            return None
        if prediction is not None:
            return self._remembered_at(frame, np.array([prediction.x_px, prediction.y_px]), front=front)
        onward = 2.0 * self._recent[-1] - self._recent[0]
        told = self._remembered_at(frame, onward, front=front) if len(self._recent) > 1 else None
        return told or self._remembered_at(frame, self._recent[-1], front=front)

    def _remembered_at(self, frame: Frame, place: Floats, *, front: bool) -> Told | None:
        """The result with the target looked for at `place` (2,) px from the first frame."""
        x, y = (float(v) for v in place)
        seen = self._look(self._current, frame, Prediction(x, y, 1.0, 1.0))
        off = self._chain.place[self._current] + seen.place - place
        lost_it = seen.found.status is not Status.TRACKING or float(np.abs(off).max()) > NEAR_PX
        # The key frame may follow what stands in front: it only says how strong the target is.
        unsure = self.settings.light_px**2
        x, y = (float(v) for v in place - self._chain.place[self._current])
        found = PixelTranslation(frame.time_ns, x, y, unsure, unsure, seen.found.quality, Status.TRACKING)
        seen = Seen(found, 0.0 if lost_it else seen.strength)
        before = self._hidden, self._doubtful, self._expected, self._carried, self._lately
        told = self._result(frame, seen, remembered=True)
        if told is None or (front and not self._hidden.any()):
            self._hidden, self._doubtful, self._expected, self._carried, self._lately = before
            return None
        return told

    def _result(self, frame: Frame, seen: Seen, *, remembered: bool = False) -> Told | None:
        """Translation since the first frame, by the mix of all pictures where there is one, the frame as seen, and how
        strong it is; None where the target is not there.

        Its variance holds those of the key frames' places and of what light may do.
        """
        if seen.found.status is not Status.TRACKING:
            return None
        place = self._chain.place[self._current] + seen.place
        own = seen.variance
        variance = self._chain.variance(self._current) + own
        usual = self._keys[self._current].usual
        view, together = self._looked_at(frame, place, weak=seen.strength < WEAK * usual)
        known = self._pictures
        found = None if together is None else together.found
        if remembered and found is None:
            return None
        if together is not None:
            if together.absent:
                return None
            self._hidden, self._doubtful = together.hidden, together.doubtful
        if found is not None and known is not None:
            self._expected = found.expected
            if known.several or remembered or self._hidden.any():
                # What a new picture corrects comes in little by little, not as a step.
                self._carried = (1.0 - 0.5 / self.settings.overlap_frames) * self._carried
                place, variance = found.place + self._carried, known.variance(self._chain, found) + self._carried**2
                # What blocks contradict each other by beyond noise stays for many frames, as the places' errors do.
                own = np.minimum(own, found.variance)
        self._own = own
        recent = [seen.strength] if self._hidden.any() else [*self._health, seen.strength][-HEALTH_FRAMES:]
        gone = share_lost(fmean(recent), usual) if usual > 0.0 else 0.0
        mixed = found is not None and known is not None and known.several
        variance = variance + self.settings.light_px**2 * (gone**2 if mixed else self._shifted(gone))
        result = replace(
            seen.found,
            x_px=float(place[0]),
            y_px=float(place[1]),
            variance_x_px2=float(variance[0]),
            variance_y_px2=float(variance[1]),
        )
        return result, view, seen.strength

    def _shifted(self, gone: float) -> float:
        """Share of strength lost, less its scatter: what goes with the square of a shift, if all of it is shading that
        moves as the target would.
        """
        strengths = self._keys[self._current].strengths
        scatter = SCATTERED * float(np.std(strengths)) / max(fmean(strengths), 1e-12) if len(strengths) > 1 else 0.0
        return max(gone - scatter, 0.0)

    def _looked_at(self, frame: Frame, place: Floats, *, weak: bool) -> tuple[Sight | None, Uncovered | None]:
        """The frame around the target and where it lies by the pictures; these are not asked without need."""
        known = self._pictures
        asked = known is not None and (known.several or weak or bool(self._hidden.any()))
        if not asked:
            self._lately = LATELY, frame.time_ns
        if not asked and self._overlap is None:
            return None, None
        view = sight(frame.pixels, self.region, place)
        if known is None or not asked or view is None or self._expected is None:
            return view, None
        if self.settings.heat:
            return view, Uncovered(placed(known.mix, view, place), ALL_SEEN, ALL_SEEN)
        best, then = self._lately
        best = best - PALING * (frame.time_ns - then) / 1e9
        told = uncovered(known.mix, view, place, (self._expected, self._hidden, best))
        if told.found is not None and not told.absent:
            agreed = np.where(told.hidden, 1.0, told.found.agreement)
            self._lately = np.maximum(best, agreed), frame.time_ns
        else:
            self._lately = self._lately[0], frame.time_ns
        return view, told

    def _aside(self, number: int, frame: Frame, prediction: Prediction | None) -> Seen:
        """What a key frame says of another picture, without a trace in its tracker."""
        tracker = self._keys[number].tracker
        before = tracker.state
        seen = self._afresh(number, frame, prediction)
        tracker.restore(before)
        return seen

    def _tried_on(self, number: int, frame: Frame, seen: Seen) -> Told | None:
        """The result by a key frame that is not in use."""
        used, self._current = self._current, number
        told = self._result(frame, seen)
        self._current = used
        return told

    def _near(self, place: Floats, prediction: Prediction | None) -> bool:
        """Whether a place (2,) px is where the target can be, by the prediction or else by where it was last seen."""
        if prediction is None:
            before = np.zeros(2) if self._last is None else self._last[1]
            return float(np.abs(place - before).max()) <= FAR_SHARE * min(self.region.width, self.region.height)
        off = np.abs(place - np.array([prediction.x_px, prediction.y_px]))
        return bool((off <= 3.0 * np.array([prediction.std_x_px, prediction.std_y_px]) + NEAR_PX).all())
