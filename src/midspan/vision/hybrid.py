"""Trackers by local phase: `PhaseTracker`, and `HybridTracker`, which finds the place first where phase could wrap.

After the paper on hybrid phase and feature matching, equations 4 and 14 to 19. The prediction rounded to whole pixels
moves the region; the mean phase of the active pixels measures what is left. Before anything has been learned, active
pixels are those of large amplitude and the gain comes from the slope of the reference's own phase.

With `literal` both are those of `midspan.papers.printed.phase`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from midspan import _core
from midspan.checks import option, refuse
from midspan.errors import DataError
from midspan.records import Floats32, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.active_pixels import ActivePixels
from midspan.vision.phase_model import (
    INSET_PX,
    SPLIT_FRAMES,
    Learning,
    PhaseModel,
    first_model,
    learned_model,
    reference_field,
    region_patch,
    target_of,
    whole_region,
)
from midspan.vision.region import check_size, inner
from midspan.vision.target import FULL_QUALITY, Motion, lost
from midspan.vision.texture import values
from midspan.vision.tracker import AXES, MAX_LEARNING_FRAMES, TRACKERS, AxisMotion, Tracker, open_tracker

MAX_LEARNING_VALUES = 30_000_000  # phases of all pixels in all frames: 120 MB
CHANCE_COHERENCE = 0.25  # unrelated texture reaches about 0.1


@dataclass(frozen=True, slots=True)
class PhaseSettings:
    """Settings of the phase and hybrid trackers.

    literal: exactly the published steps; least_information, weighted and min_coherence are then not used.
    form: "gain" (mean phase times the phase scale factor) or "gradient" (the conventional mean of phase by slope).
    min_slope_rad_px: only with "gradient", slope below which a pixel does not count, 0 rad/px or more; left out: 0.1,
    with literal 0: equation 3 has no such limit. More drops pixels whose noise the division raises.
    active_pixels: "correlation" (learned, maximum R²), "amplitude" (the conventional threshold) or "all".
    least_information: share of the information that active pixels must keep, 0 to 1. weighted: whether pixels count by
    the square of their amplitude in the mean, or equally as in the paper. matcher: the tracker that finds the target's
    whole-pixel place; left out: template, with literal features as printed. spacing: of the filters' taps in widths of
    their Gaussian, 0.3 (long waves) to 1 (short). min_coherence: share of the agreement of phases that noise allows
    below which the target counts as lost, 0 to 1. bias_floor_px: standard deviation added for what the linear gain gets
    wrong, 0 px or more.
    """

    literal: bool = False
    form: str = "gain"
    min_slope_rad_px: float | None = None
    active_pixels: str = "correlation"
    least_information: float = 0.5
    weighted: bool = True
    matcher: str = ""
    spacing: float = 0.67
    min_coherence: float = 0.5
    bias_floor_px: float = 0.0005

    def __post_init__(self) -> None:
        option("form", self.form, ("gain", "gradient"))
        option("active_pixels", self.active_pixels, ("correlation", "amplitude", "all"))
        if self.min_slope_rad_px is not None and not 0.0 <= self.min_slope_rad_px < math.pi:
            raise refuse("min_slope_rad_px", "from 0 to below π rad/px", self.min_slope_rad_px)
        if self.matcher in ("phase", "hybrid"):
            raise refuse("matcher", "a tracker that works without phase, such as template", self.matcher)
        option("matcher", self.matched_by, TRACKERS)
        if not 0.0 <= self.least_information <= 1.0:
            raise refuse("least_information", "from 0 to 1", self.least_information)
        if not 0.3 <= self.spacing <= 1.0:
            raise refuse("spacing", "from 0.3 to 1", self.spacing)
        if not 0.0 < self.min_coherence < 1.0:
            raise refuse("min_coherence", "above 0 and below 1", self.min_coherence)
        if not 0.0 <= self.bias_floor_px < math.inf:
            raise refuse("bias_floor_px", "0 px or more", self.bias_floor_px)

    @property
    def matched_by(self) -> str:
        """Name of the tracker that finds the whole-pixel place."""
        return self.matcher or ("features" if self.literal else "template")

    @property
    def as_printed(self) -> bool:
        """Whether the tracker is one of the paper's."""
        return self.literal or self.form == "gradient"


@dataclass(frozen=True, slots=True)
class PhaseState(Motion):
    """What a phase tracker remembers besides: how often the place was looked for by matching, the matcher's state and
    what was learned.
    """

    matched_frames: int = 0
    matcher: Any = None
    model: PhaseModel | None = field(default=None, compare=False)


class PhaseTracker(Tracker):
    """Local phase about the predicted or the last place; see `midspan.vision.tracker.Tracker` for its interface.

    Motion between frames, or the prediction's error, must stay well below π times the gain: about 2 px. Only a target
    that was lost is looked for by matching.
    """

    _state: PhaseState
    _max_learning_frames = MAX_LEARNING_FRAMES

    def __init__(self, reference: Frame, region: Region, settings: PhaseSettings) -> None:
        super().__init__(reference, region)
        self.settings = settings
        rows, columns = reference.pixels.shape
        self._window = inner(region, columns, rows, INSET_PX)
        self._matcher = self._open_matcher()
        part = region_patch(self._window, 0, 0, INSET_PX)
        cut = np.asarray(reference.pixels[part], dtype=np.float64)
        self._offset = float(np.mean(cut[np.isfinite(cut)])) if np.isfinite(cut).any() else 0.0
        patch = values(reference.pixels[part], self._offset)
        if patch is None:
            raise DataError(
                f"camera.roi must lie where at least 98 % of the pixels have a value; received {region}. "
                "Choose another place."
            )
        self._fields = tuple(reference_field(patch, axis, settings.spacing) for axis in AXES)
        noise = max(f.noise_share for f in self._fields)
        self._least_coherence = max(settings.min_coherence * (1.0 - noise), CHANCE_COHERENCE)
        everywhere = settings.active_pixels == "all"
        self._first = first_model(self._fields, weighted=settings.weighted, everywhere=everywhere)
        self._measured_with: tuple[PhaseModel, _core.PhaseTarget] | None = None
        self._state = PhaseState(matcher=self._matcher.state)

    def restore(self, state: PhaseState) -> None:
        """Continue from a `state` taken earlier."""
        self._state = state
        self._matcher.restore(state.matcher)

    @property
    def model(self) -> PhaseModel:
        """Active pixels and slopes in use: learned, or from the reference alone."""
        return self._state.model or self._first

    @property
    def phase_gain_px_per_rad(self) -> tuple[float, float]:
        """Translation by mean phase along x and y, px/rad, signed; times the scale factor: the phase scale factor."""
        return self.model.gains_px_per_rad

    @property
    def active_pixels(self) -> ActivePixels:
        """Active pixels in the part of the region whose phase is used: all but what lies too near to the border."""
        shape = (self._window.height, self._window.width)
        x, y = self.model.mask("x", shape), self.model.mask("y", shape)
        return ActivePixels(self._window, x, y, self.model.r_squared)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN where it cannot be found."""
        self._check_size(frame)
        fix = self._find(frame, prediction)
        if fix is None:
            self._state = self._state.missed()
            return lost(frame.time_ns)
        self._state = self._state.seen(frame.time_ns, (fix.x_px, fix.y_px))
        return fix

    @property
    def frames_to_learn(self) -> int:
        """How many frames are worth learning from: 240, fewer for large regions."""
        values_of_frame = 2 * self._window.width * self._window.height
        return min(self._max_learning_frames, max(MAX_LEARNING_VALUES // values_of_frame, SPLIT_FRAMES))

    def _learn(self, frames: Sequence[Frame], motion: AxisMotion | None) -> PhaseModel:
        """Choose active pixels and learn the gains from frames in which the target moves.

        Without `motion`, and along the other axis, by the matcher's own translations; its band is ignored. An axis that
        hardly moves keeps what is known from the reference.
        """
        step = max(1, math.ceil(len(frames) / self.frames_to_learn))
        learning = self._observe(frames[::step], None if motion is None else motion.part(slice(None, None, step)))
        if self.settings.active_pixels != "amplitude":
            model = learned_model(
                self._fields,
                self._first,
                learning,
                weighted=self.settings.weighted,
                least_information=1.0 if self.settings.active_pixels == "all" else self.settings.least_information,
            )
            self._state = replace(self._state, model=model)
        return self.model

    def _observe(self, frames: Sequence[Frame], motion: AxisMotion | None) -> Learning:
        """Phases of all pixels and the residual motion, with the region moved by the matcher's whole pixels."""
        matcher = self._open_matcher()
        target = target_of(whole_region(self._fields), self._window, self._offset, self.settings.spacing)
        phases: tuple[list[Floats32], list[Floats32]] = ([], [])
        residual = []
        for k, frame in enumerate(frames):
            self._check_size(frame)
            found = matcher.push(frame)
            if found.status is not Status.TRACKING:
                continue
            place = (round(found.x_px), round(found.y_px))
            changes = target.changes(frame.pixels, *place)
            if changes is None:
                continue
            moved = [found.x_px, found.y_px]
            if motion is not None:
                moved[motion.axis] = float(motion.translation_px[k])
                if not math.isfinite(moved[motion.axis]):
                    continue
            residual.append([moved[0] - place[0], moved[1] - place[1]])
            for kept, change in zip(phases, changes, strict=True):
                kept.append(change)
        if len(residual) < 5:
            raise DataError(f"Learning needs at least 5 frames that show the target; received {len(residual)}.")
        return Learning((np.stack(phases[0]), np.stack(phases[1])), np.array(residual))

    def _find(self, frame: Frame, prediction: Prediction | None) -> PixelTranslation | None:
        """Phase about the expected place; a target that was lost before is looked for first."""
        place, _ = self._expected(prediction)
        if self._state.lost_frames > 0:
            return self._matched(frame, prediction)
        return self._by_phase(frame, place)

    def _expected(self, prediction: Prediction | None) -> tuple[tuple[int, int], float]:
        """Whole-pixel place by equation 14, or the last one, and the standard deviation of that, px.

        The axis that the accelerometer showed counts, else the better predicted one: it is the one that the structure
        moves along; a miss along the other shows in the coherence.
        """
        if prediction is not None and math.isfinite(prediction.x_px + prediction.y_px):
            both = (prediction.std_x_px, prediction.std_y_px)
            std = min(both) if self.model.along is None else both[self.model.along]
            return (round(prediction.x_px), round(prediction.y_px)), std
        return (round(self._state.x_px), round(self._state.y_px)), math.inf

    def _matched(self, frame: Frame, prediction: Prediction | None) -> PixelTranslation | None:
        """Equations 18 and 19: the matcher finds the whole-pixel place, phase measures the rest."""
        found = self._matcher.push(frame, self._matcher_prediction(frame, prediction))
        self._state = replace(self._state, matcher=self._matcher.state, matched_frames=self._state.matched_frames + 1)
        if found.status is not Status.TRACKING:
            return None
        return self._by_phase(frame, (round(found.x_px), round(found.y_px)))

    def _matcher_prediction(self, frame: Frame, prediction: Prediction | None) -> Prediction | None:
        """Where the matcher looks: about the prediction, else about the extrapolated motion of a target just seen."""
        if prediction is None and self._state.lost_frames == 0:
            return self._state.extrapolated(frame.time_ns)
        return prediction

    def _by_phase(self, frame: Frame, place: tuple[int, int]) -> PixelTranslation | None:
        """Equation 17 about the whole-pixel `place`, which is moved once more while the residual exceeds half a pixel.

        The linear gain holds for small residuals only.
        """
        found = self._target.near_to(frame.pixels, *place)
        if found is None:
            return None
        x, y, right, down, variance_x, variance_y, coherence = found
        if coherence < self._least_coherence:
            return None
        floor_px2 = self.settings.bias_floor_px**2
        return PixelTranslation(
            time_ns=frame.time_ns,
            x_px=x + right,
            y_px=y + down,
            variance_x_px2=variance_x + floor_px2,
            variance_y_px2=variance_y + floor_px2,
            quality=coherence,
            status=Status.TRACKING,
            strength=FULL_QUALITY * coherence,
        )

    @property
    def _target(self) -> _core.PhaseTarget:
        """What measures frames with the model in use."""
        if self._measured_with is None or self._measured_with[0] is not self.model:
            self._measured_with = self.model, self._opened_target()
        return self._measured_with[1]

    def _opened_target(self) -> _core.PhaseTarget:
        return target_of(self.model, self._window, self._offset, self.settings.spacing)

    def _open_matcher(self) -> Tracker:
        return open_tracker(self.settings.matched_by, self.reference, self.region)

    def _check_size(self, frame: Frame) -> None:
        check_size(frame, self.reference)


class HybridTracker(PhaseTracker):
    """Phase where it cannot wrap, else matching first and then phase (equations 14 to 19)."""

    def could_wrap(self, prediction: Prediction | None) -> bool:
        """Whether the 99.7 % bound of the residual motion reaches π times the gain (equation 16)."""
        _, std = self._expected(prediction)
        gains, along = np.abs(self.phase_gain_px_per_rad), self.model.along
        return not 3.0 * std + 0.5 < math.pi * float(gains.min() if along is None else gains[along])

    def _find(self, frame: Frame, prediction: Prediction | None) -> PixelTranslation | None:
        """Equations 14 to 19."""
        if self._state.lost_frames == 0 and not self.could_wrap(prediction):
            place, _ = self._expected(prediction)
            fix = self._by_phase(frame, place)
            if fix is not None:
                return fix
        return self._matched(frame, prediction)
