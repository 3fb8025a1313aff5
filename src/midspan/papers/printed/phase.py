"""Trackers by local phase as printed: active pixels and phase scale factor by the accelerometer.

Z. Ma, J. Choi, P. Liu, H. Sohn, "Structural displacement estimation by fusing vision camera and accelerometer using
hybrid computer vision algorithm and adaptive multi-rate Kalman filter", Automation in Construction 140 (2022) 104338,
doi 10.1016/j.autcon.2022.104338, section 3.1, step 3: residual motion and phases of the moved region go through one
band-pass; the threshold of correlation with the largest R² chooses the pixels, and least squares give the ratio of
translation to their mean phase, which is beta / alpha of the paper.

The phase tracker is the paper's section 2 (the region stays where it is, equations 3 and 4), the hybrid its section 3:
one axis alone, all active pixels alike, nothing taken back. Until they have estimated from the accelerometer both give
what the matcher finds, which is step 1 of the paper's calibration.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan._core import PhaseTarget
from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Floats32, Frame, PixelTranslation, Prediction, Region, Status
from midspan.signals.band_pass import band_passed
from midspan.signals.health import Mask
from midspan.vision.active_pixels import Selection, by_amplitude, slope_and_r_squared
from midspan.vision.hybrid import HybridTracker, PhaseSettings, PhaseTracker
from midspan.vision.phase_model import INSET_PX, Field, Learning, PhaseModel, phase_slopes, region_patch, target_of
from midspan.vision.steerable import Complex64, quadrature
from midspan.vision.texture import values
from midspan.vision.tracker import AxisMotion, Tracker, open_tracker, tracker_settings

MIN_FILTERED = 30  # frames, as the band-pass needs
MAX_LEARNING_FRAMES = 500  # 50 s at 10 frames a second
MIN_SLOPE_RAD_PX = 0.1  # below it equation 3 would divide by next to nothing
TOGETHER = 512  # pixels whose mean phases are summed up in one array


class _Conventional(PhaseTracker):
    """The conventional form of phase trackers, "gradient", where the settings say so."""

    def _by_phase(self, frame: Frame, place: tuple[int, int]) -> PixelTranslation | None:
        fix = super()._by_phase(frame, place)
        near = None if self.settings.form == "gain" else self._target.near_to(frame.pixels, *place)
        if fix is None or near is None:
            return fix
        x, y = near[:2]
        right, down = self._gradient_px(frame.pixels, (x, y))
        return replace(fix, x_px=x + right, y_px=y + down) if math.isfinite(right + down) else None

    def _gradient_px(self, pixels: NDArray[np.generic], place: tuple[int, int]) -> tuple[float, float]:
        """Equation 3 along both axes, px; NaN where the region leaves the image."""
        settings = self.settings
        rows, columns = region_patch(self._window, *place, INSET_PX)
        outside = min(rows.start, columns.start) < 0 or rows.stop > pixels.shape[0] or columns.stop > pixels.shape[1]
        patch = None if outside else values(pixels[rows, columns], self._offset)
        if patch is None:
            return math.nan, math.nan
        min_slope = 0.0 if settings.literal else MIN_SLOPE_RAD_PX
        if settings.min_slope_rad_px is not None:
            min_slope = settings.min_slope_rad_px
        both = []
        for k, axis in enumerate(self.model.axes):
            now = quadrature(patch, "xy"[k], settings.spacing)
            slope = phase_slopes(now)[k].ravel()[axis.index]
            inner = np.ascontiguousarray(now[1:-1, 1:-1])
            change = phase_change((inner.real.copy(), inner.imag.copy()), axis.reference, axis.index)
            both.append(gradient_form(change, slope, min_slope))
        return both[0], both[1]


class _ConventionalHybrid(_Conventional, HybridTracker):
    """The hybrid with the conventional form."""


class _PrintedPhase(_Conventional):
    """What both printed trackers do: they learn with the accelerometer, and measure one axis alone."""

    _max_learning_frames = MAX_LEARNING_FRAMES

    def __init__(self, reference: Frame, region: Region, settings: PhaseSettings) -> None:
        super().__init__(reference, region, replace(settings, weighted=False))
        self._least_coherence = -math.inf

    @property
    def learns_by_acceleration(self) -> bool:
        """Whether it must have estimated before it measures; the conventional forms need not."""
        return self.settings.form == "gain" or self.settings.active_pixels == "correlation"

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`: the matcher's until the tracker has estimated."""
        if not self.learns_by_acceleration or self._state.model is not None:
            return super().push(frame, prediction)
        self._check_size(frame)
        translation = self._matcher.push(frame, prediction)
        if translation.status is Status.TRACKING:
            state = self._state.seen(frame.time_ns, (translation.x_px, translation.y_px))
        else:
            state = self._state.missed()
        self._state = replace(state, matcher=self._matcher.state)
        return translation

    def _learn(self, frames: Sequence[Frame], motion: AxisMotion | None) -> PhaseModel:
        """Step 3 of the calibration, from the first frames, evenly spaced but for those that the matcher loses.

        Both sides are compared within the motion's band.
        """
        frames = frames[: self.frames_to_learn]
        motion = None if motion is None else motion.part(slice(len(frames)))
        rate_hz = NANOSECONDS / max(float(np.median(np.diff([frame.time_ns for frame in frames]))), 1.0)
        along, band_hz = (None, None) if motion is None else (motion.axis, motion.band_hz)
        rule = PrintedRule(self.settings.active_pixels, along, band_hz, rate_hz)
        learning = self._observe(frames, motion)
        self._state = replace(self._state, model=printed_model(self._fields, self._first, learning, rule))
        return self.model

    def _matcher_prediction(self, frame: Frame, prediction: Prediction | None) -> Prediction | None:
        return prediction

    def _opened_target(self) -> PhaseTarget:
        window, spacing = self._window, self.settings.spacing
        return target_of(self.model, window, self._offset, spacing, self.model.gains_px_per_rad)

    def _open_matcher(self) -> Tracker:
        name = self.settings.matched_by
        printed = {"literal": True} if name == "features" else {}
        return open_tracker(name, self.reference, self.region, tracker_settings(name, **printed))


class PrintedPhaseTracker(_PrintedPhase):
    """Local phase in a region that stays; see `midspan.vision.tracker.Tracker` for its interface."""

    def _find(self, frame: Frame, prediction: Prediction | None) -> PixelTranslation | None:
        return self._by_phase(frame, (0, 0))


class PrintedHybridTracker(_PrintedPhase, HybridTracker):
    """Phase where it cannot wrap, else matching first; see `midspan.vision.tracker.Tracker` for its interface."""


def printed_phase(reference: Frame, region: Region, settings: PhaseSettings) -> PhaseTracker:
    """The phase tracker with the paper's form, its steps guarded or exactly as printed."""
    return (PrintedPhaseTracker if settings.literal else _Conventional)(reference, region, settings)


def printed_hybrid(reference: Frame, region: Region, settings: PhaseSettings) -> HybridTracker:
    """The hybrid tracker with the paper's form, its steps guarded or exactly as printed."""
    return (PrintedHybridTracker if settings.literal else _ConventionalHybrid)(reference, region, settings)


@dataclass(frozen=True, slots=True)
class PrintedRule:
    """How a model is estimated as printed.

    active_pixels: "correlation" (the paper's), "amplitude" or "all". along: number of the image axis that the
    accelerometer showed, None for both. band_hz: of the comparison, None for no filter; rate_hz: of the frames.
    """

    active_pixels: str
    along: int | None
    band_hz: tuple[float, float] | None
    rate_hz: float


def printed_model(fields: Sequence[Field], first: PhaseModel, learning: Learning, rule: PrintedRule) -> PhaseModel:
    """The model with active pixels and ratio of each axis that is estimated; the other one stays as it was at `first`.

    Raises DataError with too few frames for the band-pass.
    """
    axes, ratios, fits = list(first.axes), list(first.gains_px_per_rad), list(first.r_squared)
    for k in (0, 1) if rule.along is None else (rule.along,):
        found = _selected(fields[k], learning, k, rule)
        count = int(np.count_nonzero(found.active))
        axes[k] = fields[k].chosen(found.active, np.ones(count), fields[k].slope[found.active], 0.0)
        ratios[k], fits[k] = found.gain_px_per_rad, found.r_squared
    x, y = axes
    return replace(first, x=x, y=y, ratios=(ratios[0], ratios[1]), r_squared=(fits[0], fits[1]), along=rule.along)


def _selected(field: Field, learning: Learning, k: int, rule: PrintedRule) -> Selection:
    """Steps b to d along the axis `k`."""
    phase, residual = learning.phase[k], learning.residual_px[:, k]
    phase, residual = phase - phase.mean(axis=0), residual - residual.mean()
    if rule.band_hz is not None:
        if len(residual) < MIN_FILTERED:
            raise DataError(f"Learning needs at least {MIN_FILTERED} frames with the target; received {len(residual)}.")
        filtered = band_passed(phase, rule.rate_hz, rule.band_hz)
        residual = band_passed(residual, rule.rate_hz, rule.band_hz)
    else:
        filtered = phase.astype(np.float64)
    if rule.active_pixels == "correlation":
        return by_threshold(filtered, residual)
    amplitude = by_amplitude(field.amplitude).ravel()
    return by_ratio(filtered, residual, amplitude | (rule.active_pixels == "all"))


def by_threshold(phase: Floats | Floats32, translation: Floats) -> Selection:
    """Pixels by the threshold of |correlation| with the largest R² as printed: every threshold, all pixels alike.

    `phase` (n, k) rad and `translation` (n,) px, both band-passed: steps b to d of the calibration. The gain is the
    least-squares ratio of translation to mean phase.
    """
    order = np.argsort(-slope_and_r_squared(phase, translation)[1], kind="stable")
    dots, squares = np.empty(len(order)), np.empty(len(order))
    before = np.zeros(len(translation))
    for first in range(0, len(order), TOGETHER):
        block = slice(first, first + TOGETHER)
        sums = before[:, None] + np.cumsum(phase[:, order[block]], axis=1, dtype=np.float64)
        dots[block], squares[block] = translation @ sums, np.sum(sums * sums, axis=0)
        before = sums[:, -1]
    fits = dots**2 / np.maximum(squares * float(translation @ translation), 1e-300)
    best = int(np.argmax(fits))
    active = np.zeros(len(order), dtype=bool)
    active[order[: best + 1]] = True
    return Selection(active, (best + 1) * float(dots[best] / squares[best]), float(fits[best]))


def by_ratio(phase: Floats | Floats32, translation: Floats, active: Mask) -> Selection:
    """Given active pixels (k,) with the gain and R² of `by_threshold`."""
    mean = phase[:, active].mean(axis=1, dtype=np.float64)
    dot, square = float(translation @ mean), float(mean @ mean)
    return Selection(active, dot / square, dot**2 / (square * float(translation @ translation)))


def phase_change(now: tuple[Floats32, Floats32], reference: Complex64, index: NDArray[np.int64]) -> Floats32:
    """Phase of the responses `now` (even, odd: rows, columns) less the reference's at the pixels `index`: (k,) rad.

    `reference` (k,) are the reference's responses there. The angle of the complex product lies in -π … π on its own;
    a difference of two angles would not.
    """
    here = (now[0] + 1j * now[1]).ravel()[index]
    return np.asarray(np.angle(here * np.conj(reference)), dtype=np.float32)


def gradient_form(change: Floats32, slope: Floats, min_slope_rad_px: float = MIN_SLOPE_RAD_PX) -> float:
    """Translation in px as the mean of -change / slope over the pixels (k,): equation 3 without its scale factor.

    `change` in rad, `slope` of the current frame's phase along the axis in rad/px; pixels with next to no slope are
    left out (below `min_slope_rad_px`; the equation has no such limit: 0). NaN without any.
    """
    steep = np.abs(slope) >= max(min_slope_rad_px, 1e-300)
    if not steep.any():
        return float("nan")
    return float(np.mean(-change[steep].astype(np.float64) / slope[steep]))
