"""What a camera is calibrated on: an image axis and its acceleration, and each target as it was tracked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from midspan.calibration.fit import Pair, measured_rows
from midspan.calibration.scale import ScaleCalibration, calibrate_scale
from midspan.calibration.sensors.camera import CameraCalibration, CameraScale
from midspan.calibration.whitening import BIAS_WALK_RATIO
from midspan.errors import NoAgreementError, UntrustedError, UsageError
from midspan.fusion.methods import named
from midspan.fusion.streams import KalmanSettings
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, PixelTrack, Region, ScaleFactor, TimeOffset
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.averaging import at_instants
from midspan.signals.band_pass import band_passed
from midspan.signals.stamps import inside
from midspan.vision.lens import Lens
from midspan.vision.picture_report import PictureReport
from midspan.vision.region_choice import Agreement
from midspan.vision.tracker import Tracker

# What stands in `papers`, above this room: a scale factor and a clock offset as the papers print them.
PRINTED = "midspan.papers.printed.camera:calibrate_printed"
# So far beyond the calibration window a clock is looked for, s.
BEYOND_S = 30.0
# A printed scale factor that is off by more than this share is no calibration; the papers differ by up to a tenth.
MAX_APART = 0.5


@dataclass(frozen=True, slots=True)
class PrintedSteps:
    """How the steps are done, which the papers leave to the reader.

    band_hz: lower and upper end; None: the papers'. spline: the cross-correlation is interpolated (two-stage paper,
    step 3); without, the offset is a whole number of frame intervals. sampled_first: the displacement is brought to the
    camera's rate before it is filtered (two-stage paper, step 2), so that both series are aliased alike; otherwise
    after (AMKF paper). sign: of the scale factor, 1 or -1, which the papers know; 0: it is not known.
    """

    band_hz: tuple[float, float] | None = None
    spline: bool = True
    sampled_first: bool = True
    sign: int = 0


@dataclass(frozen=True, slots=True)
class View:
    """One image axis "x" or "y" of a camera with the acceleration along it.

    window: the samples of the calibration window; max_offset_s: largest clock offset looked for; band_hz: where the
    acceleration decides the scale factor (None: everywhere); exposure_s: None where undeclared. scale: where it is
    known beforehand; printed: how scale and offset are calibrated as printed, None: by likelihood; late_ns: about what
    is to be added to the frames' stamps (ns), besides which the offset is looked for; clocks_open: whether nothing is
    said of how far the clocks may be apart.
    """

    axis: str
    prepared: PreparedAcceleration
    window: slice
    max_offset_s: float
    band_hz: tuple[float, float] | None = None
    exposure_s: float | None = None
    scale: ScaleFactor | None = None
    printed: PrintedSteps | None = None
    late_ns: int = 0
    clocks_open: bool = False

    @property
    def window_ns(self) -> tuple[int, int]:
        """First and last stamp (ns) of the window."""
        time_ns = self.prepared.time_ns
        return int(time_ns[self.window.start]), int(time_ns[self.window.stop - 1])

    def offset(self, near: TimeOffset) -> TimeOffset:
        """The clock offset of a camera where `near` was found of its `camera_pair`."""
        return TimeOffset(near.value_s + self.late_ns / NANOSECONDS, near.variance) if self.late_ns else near


@dataclass(frozen=True, slots=True)
class Lever:
    """How far a target lies from the optical axis along an image axis; what is left of the zoom's motion, rms; px."""

    value_px: float
    left_px: float

    def text(self, scale_m_per_px: float) -> Notice:
        """A sentence on it."""
        text = (
            "camera: the image scale varies, from autofocus or a target that moves in depth. The resulting shift, "
            f"{self.value_px:.3g} px times the zoom, is removed; {1e3 * self.left_px * abs(scale_m_per_px):.2g} mm "
            "rms remain uncertain and are in the error band. Lock the focus, or choose a target near the image centre."
        )
        return Notice("picture-zooms", text)


@dataclass(frozen=True, slots=True, eq=False)
class SeenTarget:
    """One target as it was tracked through the window.

    rows: with the variances of single frames; reference_px2 (n, 2): what the reference frame makes besides, along x and
    y; blur_s: over which a translation is averaged; picture: what compression does, None where there is none;
    tracker, tracker_name, tracker_settings: what it was tracked with; lens: whose distortion was taken out; frame_px:
    width and height of the frames; levers: along image axes, of the zoom whose motion the rows are without.
    inverse_distance: as declared, and its standard deviation, 1/m; None: unknown.
    """

    name: str
    region: Region
    rows: PixelTrack
    reference_px2: Floats
    blur_s: float
    picture: PictureReport | None
    tracker: Tracker
    tracker_name: str
    tracker_settings: Any
    lens: Lens | None
    frame_px: tuple[int, int]
    levers: Mapping[str, Lever] = field(default_factory=dict)
    inverse_distance: tuple[float, float] | None = None

    def lever_px(self, axis: str) -> float:
        """The lever along an image axis, px; 0 where no zoom shows."""
        return self.levers[axis].value_px if axis in self.levers else 0.0

    def with_picture_error(self, scale: ScaleFactor, direction: str) -> ScaleFactor:
        """A scale factor estimated along an image axis on the rows, with what compression and a thermal camera's fixed
        pattern may do to it.
        """
        return scale.wider(float(np.hypot(self.codec_std(direction), self.tracker.scale_share_std)))

    def codec_std(self, direction: str) -> float:
        """What compression may do to a scale factor along an image axis, relative."""
        return 0.0 if self.picture is None else self.picture.relative_scale_std(direction)


def camera_pair(
    view: View, track: PixelTrack, blur_s: float, *, beyond: bool = False, other: PixelTrack | None = None
) -> Pair:
    """A target's translation along the axis, its stamps later by `late_ns`, and the acceleration, in the window.

    beyond: whether with what lies before and after the window, too, as where its clock is looked for there; other: a
    target in the same frames that shows the camera's tilt.
    """
    first, last = view.window_ns
    if not len(track.time_ns):
        raise UntrustedError(
            "No frame of the calibration window shows the target. Choose another calibration.window_s or region."
        )
    # Frames close to the window's ends could fall outside it at the largest clock offset and would change the sum.
    margin = round(view.max_offset_s * NANOSECONDS)
    time_ns = track.time_ns + view.late_ns
    reach = round(BEYOND_S * NANOSECONDS) if beyond else 0
    last = last if beyond else min(last, int(time_ns[-1]) + margin + NANOSECONDS)
    window = inside(view.prepared.time_ns, first - reach, last + reach)
    value, variance = track.along(view.axis)
    inner = inside(time_ns, first + margin, last - margin)
    rows = measured_rows(time_ns[inner], value[inner], variance[inner], first)
    samples, outside = in_band(view.prepared.rows(first, window), view.band_hz)
    level, cross = view.prepared.level(window), view.prepared.cross_rows(window)
    ratio = None if view.scale is None else 1.0 / view.scale.value_m_per_px
    seen = None if other is None else other.along(view.axis)[0][inner]
    lines = view.prepared.lines
    return Pair(samples, rows, ratio, blur_s, outside, level_m_s2=level, cross=cross, lines=lines, seen=seen)


def scale_of(view: View, pair: Pair, *, slow_errors: bool = True) -> ScaleCalibration:
    """Scale factor, clock offset beyond the view's and noise of a target; UntrustedError where it is refused.

    slow_errors: as of `calibrate_scale`.
    """
    return calibrate_scale(
        pair,
        view.max_offset_s,
        exposure_declared=view.exposure_s is not None,
        clocks_open=view.clocks_open,
        slow_errors=slow_errors,
    )


def scale_on_any_clock(view: View, target: SeenTarget) -> ScaleCalibration:
    """As `scale_of`; where nothing is said of the clocks, a refusal names the offset beyond the window that agrees."""
    try:
        return scale_of(view, camera_pair(view, target.rows, target.blur_s))
    except NoAgreementError as error:
        if error.clock_offset_s is not None or not view.clocks_open:
            raise
        try:
            scale_of(view, camera_pair(view, target.rows, target.blur_s, beyond=True))
        except NoAgreementError as farther:
            if farther.clock_offset_s is not None:
                raise farther from None
        except UntrustedError:
            pass
        raise


def printed_along(view: View, seen: SeenTarget, likely: ScaleFactor | None) -> tuple[ScaleFactor, TimeOffset]:
    """Scale factor and clock offset of a target as printed, the scale factor as known where it is.

    likely: by the likelihood; it gives the sign, which the papers know. Raises UntrustedError where the printed one
    is farther from it than half of it.
    """
    pair, steps = camera_pair(replace(view, band_hz=None), seen.rows, seen.blur_s), view.printed or PrintedSteps()
    known = view.scale or likely
    if known is not None:
        steps = replace(steps, sign=int(np.sign(known.value_m_per_px)))
    scale, offset = named(PRINTED)(pair, view.max_offset_s, steps)
    if view.scale is None and likely is not None:
        share = scale.value_m_per_px / likely.value_m_per_px
        if not abs(share - 1.0) <= MAX_APART:
            raise UntrustedError(
                f"calibration.literal: the printed steps give {1e3 * scale.value_m_per_px:.4g} mm/px and the "
                f"likelihood {1e3 * likely.value_m_per_px:.4g}; they must agree within {100 * MAX_APART:g} %. At a "
                "low frame rate the printed steps find the clock offset only at whole frame intervals. Leave literal "
                "out, raise the frame rate, or set calibration.band_hz to the structure's frequencies."
            )
    return view.scale or scale, view.offset(offset)


def in_band(samples: Floats, band_hz: tuple[float, float] | None) -> tuple[Floats, Floats | None]:
    """Samples (n, 3) with the acceleration of a band (zero phase), and those with the rest of it; None for no band."""
    if band_hz is None:
        return samples, None
    length_s = float(samples[-1, 0] - samples[0, 0])
    rate = (len(samples) - 1) / length_s
    low, high = band_hz[0], min(band_hz[1], 0.49 * rate)
    if high * length_s < 1.0:
        raise UsageError(
            f"calibration.band_hz = {list(band_hz)}: must reach above {1.0 / length_s:.4g} Hz, one cycle in the "
            f"{length_s:.4g} s that are used. Give frequencies in Hz."
        )
    if low * length_s < 1.0:
        # A filter that swings more slowly than the samples last rings from end to end, or cannot be solved.
        low = 0.0
    if low >= high:
        raise UsageError(
            f"calibration.band_hz = {list(band_hz)}: must lie below the accelerometer's Nyquist frequency, half of "
            f"{rate:.4g} Hz."
        )
    inside, outside = samples.copy(), samples.copy()
    inside[:, 1] = band_passed(samples[:, 1], rate, (low, high))
    outside[:, 1] -= inside[:, 1]
    return inside, outside


def judged_by(view: View, track: PixelTrack, *, beyond: bool = False) -> Agreement:
    """What the accelerometer says of a place that was followed for a while.

    beyond: whether a clock offset beyond the range may be the right one, where nothing is said of the clocks.
    """
    try:
        found = _roughly(view, track, beyond=beyond and view.clocks_open)
    except UntrustedError as error:
        text = str(error)
        return Agreement(np.inf, isinstance(error, NoAgreementError), text.split(" (")[0].split(":")[0].rstrip("."))
    std_m = abs(found.scale.value_m_per_px) * found.noise.std
    text = f"fits the accelerometer, {1e3 * found.scale.value_m_per_px:.3g} mm/px, noise {1e3 * std_m:.2g} mm a frame"
    missed = float(np.mean(~np.isfinite(found.search.pair.rows[:, 2])))
    reported = f"{text}, missed in {100 * missed:.2g} % of the frames" if missed > 0.0 else text
    return Agreement(std_m, False, reported, missed, found.scale.value_m_per_px)


def _roughly(view: View, track: PixelTrack, *, beyond: bool) -> ScaleCalibration:
    """Scale factor and noise of a place that was followed for a while."""
    pair = camera_pair(view, track, view.exposure_s or 0.0, beyond=beyond)
    try:
        # Slow errors are the camera's, alike in all places.
        return scale_of(replace(view, clocks_open=False), pair, slow_errors=False)
    except NoAgreementError as error:
        if not beyond or error.clock_offset_s is None:
            raise
        late_ns = view.late_ns + round(error.clock_offset_s * NANOSECONDS)
    return _roughly(replace(view, late_ns=late_ns), track, beyond=False)


def camera_blocks(
    targets: Sequence[SeenTarget], camera: CameraCalibration, acceleration: Acceleration
) -> list[Displacement]:
    """The displacement that each target in use says, on the accelerometer's clock, without the exposure's averaging."""
    pairs = zip(targets, camera.mappings(), strict=True)
    return [target_block(target, mapping, camera.exposure_s, acceleration) for target, mapping in pairs]


def target_block(
    target: SeenTarget, mapping: CameraScale, exposure_s: float, acceleration: Acceleration
) -> Displacement:
    """The displacement that one target says; exposure_s: as estimated, that of a camera of which none was declared."""
    blur_s = float(np.hypot(target.blur_s, exposure_s))
    block = at_instants(mapping.displacement(target.rows), blur_s, acceleration)
    # What the reference frame makes is not among what the factor was estimated from.
    more = mapping.scale_m_per_px**2 * target.reference_px2[:, "xy".index(mapping.direction)]
    return replace(block, variance_m2=block.variance_m2 + more)


def filter_settings(
    prepared: PreparedAcceleration, density: float, bias: float | None = None, lean: float = 0.0
) -> KalmanSettings:
    """First guesses for the filter: the bias (the mean when left out) and how well it is known.

    density: of the acceleration's noise, (m/s²)²/Hz; lean: as of `KalmanSettings`. Without any acceleration the motion
    is that noise, and its slow part is left to the bias as it was when the density was estimated.
    """
    value = prepared.value_m_s2
    if not value.any():
        return KalmanSettings(bias_walk=BIAS_WALK_RATIO * density, bias_std=float(np.sqrt(density)) + 1e-9)
    noise = float(np.sqrt(density * prepared.rate_hz))
    # A mean over motion is off by some of the motion.
    return KalmanSettings(
        bias=float(np.mean(value)) if bias is None else bias,
        bias_std=float(0.3 * np.std(value) + 10.0 * noise + 1e-4),
        lean=lean,
    )
