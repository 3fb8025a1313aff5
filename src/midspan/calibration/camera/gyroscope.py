"""A gyroscope on the box of a camera: the focal length by which the image shows its rotation, and scales without tilt.

How both are found is in `rotation`; here all targets are taken together, and what does not fit is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.agreement import clearly_better
from midspan.calibration.camera.calibrate import CameraFit
from midspan.calibration.camera.rotation import (
    CONTRADICT_SHARE,
    CONTRADICT_STD,
    MAX_FOCAL_STD,
    MAX_LATE_S,
    Compared,
    Settled,
)
from midspan.calibration.camera.turning import SEEN_HZ, Turning, turning_of
from midspan.calibration.camera.view import SeenTarget, View
from midspan.calibration.camera.zoom import without_zoom
from midspan.calibration.common_offset import Fitted, weighted_median
from midspan.calibration.scale import ScaleCalibration
from midspan.calibration.sensors.camera import SLOW_TILT
from midspan.errors import UntrustedError
from midspan.notices import Notice, rounded
from midspan.records import ScaleFactor, TimeSeries

# Where nothing is declared: a gyroscope's bias, rad/s, and how its bias drifts: by 3 °/h in an hour, rad²/s³.
BIAS_STD = float(np.radians(0.3))
BIAS_WALK = float(np.radians(3.0 / 3600.0)) ** 2 / 3600.0
# Focal lengths of cameras, in widths of the picture: fields of view of 127° and 0.6°.
FOCAL_WIDTHS = (0.25, 100.0)
# The same in px, where a table of a track says nothing of the picture.
FOCAL_PX = (300.0, 200_000.0)
# What is right to this many standard deviations is certain.
CERTAIN = 3.0
# Clocks of one logger are as close, s.
SAME_CLOCK_S = 0.01
# A tilt is no less than this share of the gyroscope's noise.
MIN_TILT = 0.1


class StillError(UntrustedError):
    """The camera rotates too little for its gyroscope to help: nothing is wrong with it."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroscopeFit:
    """A gyroscope relative to the camera on its box, along one image axis.

    focal_px, focal_std_px: by which the image shows the rotation; noise_rad_s: of one sample; bias_rad_s: the mean of
    the calibration window, bias_std_rad_s: how well that is the bias; bias_walk: rad²/s³; offset_s, offset_std_s: what
    is to be added to the gyroscope's stamps; scales, found, reasons: of each target without the tilt, None and a reason
    where it has none; tilt_std_px: rms of the tilt in the image above
    `turning.SEEN_HZ`, which the gyroscope sees; slow_tilt_px: what is taken for the slower part.
    """

    focal_px: float
    focal_std_px: float
    noise_rad_s: float
    bias_rad_s: float
    bias_std_rad_s: float
    bias_walk: float
    offset_s: float
    offset_std_s: float
    scales: tuple[ScaleFactor | None, ...]
    found: tuple[ScaleCalibration | None, ...]
    reasons: tuple[str, ...]
    tilt_std_px: float
    slow_tilt_px: float
    notices: tuple[Notice, ...] = ()

    @property
    def fitted(self) -> Fitted:
        """What `fit_camera` takes along the axis instead of what the targets alone tell."""
        return Fitted(self.found, self.reasons)


def fit_gyroscope(
    view: View,
    targets: Sequence[SeenTarget],
    gyroscope: TimeSeries,
    fits: Sequence[CameraFit] = (),
    *,
    noise_density: float | None = None,
    bias_std: float | None = None,
    focal_px: tuple[float, float] | None = None,
) -> GyroscopeFit:
    """Calibrate a gyroscope against the camera on its box.

    gyroscope: rad/s, on the accelerometer's clock up to `rotation.MAX_LATE_S`, of the rotation that moves the picture
    along the view's axis towards positive: along y the one about x, along x the one about y with its sign changed (x
    right, y down, z along the view, right-handed); fits: of the camera without it, for its clock offset; empty where
    that was refused: the offset is looked for.
    noise_density: one-sided, rad/s/√Hz; bias_std: rad/s; focal_px: of a lens, and its standard deviation.
    Raises UntrustedError where the gyroscope does not go with the picture, or neither tells the focal length.
    """
    turning = turning_of(gyroscope, view.window_ns, noise_density)
    width = max(target.frame_px[0] for target in targets)
    compared = [_compared(view, without_zoom([view], target), turning, fits) for target in targets]
    settled = [one for one in compared if not isinstance(one, UntrustedError)]
    if not settled:
        raise UntrustedError(_reasons(targets, compared))
    usual = _usual([at for _, at in settled], focal_px)
    agreeing = [at for _, at in settled if not at.contradicts(usual)]
    focal = _focal(agreeing or [at for _, at in settled], focal_px, width)
    scaled = [one if isinstance(one, UntrustedError) else _scaled(*one, focal) for one in compared]
    if all(isinstance(one, UntrustedError) for one in scaled):
        raise UntrustedError(_reasons(targets, scaled))
    return _fit_of(turning, focal, [at for _, at in settled], BIAS_STD if bias_std is None else bias_std, scaled)


def _reasons(targets: Sequence[SeenTarget], why: Sequence[object]) -> str:
    """Why no target is calibrated, each reason once."""
    if len(set(map(str, why))) == 1:
        return str(why[0])
    return " ".join(f"Target {target.name}: {one}" for target, one in zip(targets, why, strict=True))


def _compared(
    view: View, target: SeenTarget, turning: Turning, fits: Sequence[CameraFit]
) -> tuple[Compared, Settled] | UntrustedError:
    """A target's estimate, or why there is none."""
    try:
        tried = []
        for offset_s in Compared(view, target, turning).offsets_s(fits):
            compared = Compared(view, target, turning)
            at = compared.settled(offset_s)
            tried.append((compared, at, compared.fit(at)))
        best, *others = sorted(tried, key=lambda one: -one[2].likelihood)
        for _, at, other in others:
            if not clearly_better(best[2], other):
                offsets = f"{best[1].place.offset_s:+.4f} s and {at.place.offset_s:+.4f} s"
                raise UntrustedError(
                    f"The clock offset is ambiguous: {offsets} fit almost equally well. Set a smaller "
                    "calibration.max_offset_s that excludes one of them."
                )
        return best[:2]
    except UntrustedError as error:
        return error


def _scaled(
    compared: Compared, at: Settled, focal: tuple[float, float]
) -> tuple[ScaleFactor, ScaleCalibration] | UntrustedError:
    """A target's scale with the focal length of all and its standard deviation, px; or why there is none."""
    place = at.place if at.tells else compared.begun
    try:
        # With another focal length the noise levels are others.
        at = compared.near(replace(place, focal=focal[0]), focal[0])
        own = compared.joint(at.place)
        if replace(at, joint=own, variance=own.focal_variance).contradicts(focal):
            raise UntrustedError(
                f"By the gyroscope its focal length is {own.focal:.4g} ± {np.sqrt(own.focal_variance):.2g} px, by the "
                f"other targets or the lens {focal[0]:.4g} px: it moves on its own, or turns with the camera."
            )
        found = compared.scale(at)
        found = replace(found, scale=at.widened(found.scale, focal[1]))
        return found.scale.wider(found.response.relative_std), found
    except UntrustedError as error:
        return error


def _usual(settled: Sequence[Settled], lens: tuple[float, float] | None) -> tuple[float, float]:
    """The focal length that targets are compared with and its standard deviation, px: the lens', or of most of them."""
    if lens is not None:
        return lens
    known = [at for at in settled if at.tells and at.joint.focal > 0.0]
    if not known:
        return np.nan, np.inf
    value = weighted_median(np.array([at.joint.focal for at in known]), [1.0 / at.variance for at in known])
    return value, float(min(np.sqrt(at.variance) for at in known))


def _focal(settled: Sequence[Settled], lens: tuple[float, float] | None, width: int) -> tuple[float, float]:
    """The focal length of all targets and the lens, and its standard deviation, px."""
    known = [at for at in settled if at.joint.shows]
    value, std, late_s = np.nan, np.inf, 0.0
    if known:
        late_s = max((at.place.offset_s - at.place.turned_s for at in known), key=abs)
        weight = np.array([1.0 / at.variance for at in known])
        weight /= np.sum(weight)
        # What the gyroscope errs by is in all of them.
        value = float(weight @ [at.joint.focal for at in known])
        std = float(weight @ [np.sqrt(at.variance) for at in known])
    certain = std <= MAX_FOCAL_STD * abs(value)
    if lens is None:
        if known:
            _refuse_focal(value, std, width, late_s)
        if not certain:
            raise StillError(
                "gyroscope: the camera rotates too little, apart from what goes with the displacement, to show the "
                "focal length. Give camera.lens, or choose a calibration.window_s with more rotation. If it does "
                "rotate, the axes are permuted: image axis y shows the rotation about x, and x that about y."
            )
        _refuse_width(value, std, width)
        return value, std
    apart = abs(value - lens[0])
    if apart > CONTRADICT_STD * np.hypot(std, lens[1]) and apart > CONTRADICT_SHARE * lens[0]:
        _refuse_focal(value, std, lens[0], late_s)
        raise UntrustedError(
            f"gyroscope: by it the focal length is {value:.4g} ± {std:.2g} px, by camera.lens {lens[0]:.4g} ± "
            f"{lens[1]:.2g} px. Check gyroscope.unit (deg/s and rad/s differ by a factor of 57.3), its sensitivity and "
            "axes, and the lens."
        )
    if not certain or lens[1] == 0.0:
        return lens
    weight = np.array([std**-2.0, lens[1] ** -2.0])
    return float(weight @ [value, lens[0]] / np.sum(weight)), float(np.sum(weight) ** -0.5)


def _refuse_focal(value: float, std: float, usual: float, late_s: float) -> None:
    """UntrustedError for a focal length that is negative, or none while a usual one would show.

    late_s: what would be added to the gyroscope's stamps; a tone half a period late has the opposite sign.
    """
    if value < -CERTAIN * std and abs(late_s) > SAME_CLOCK_S:
        raise UntrustedError(
            f"gyroscope: its rotation has the wrong sign ({value:.4g} ± {std:.2g} px) and is {1e3 * late_s:+.0f} ms "
            f"off: its clock differs by more than {MAX_LATE_S:g} s, or its channel is reversed. Check its time stamps "
            "and gyroscope.start_s first, then the sign; its axes are the camera's (x right, y down, z along the view)."
        )
    if value < -CERTAIN * std:
        raise UntrustedError(
            f"gyroscope: its rotation has the wrong sign, the focal length would be {value:.4g} ± {std:.2g} px. Its "
            "axes are the camera's: x right, y down, z along the view, right-handed. Change the channel's sign."
        )
    if value < CERTAIN * std and value + CERTAIN * std < usual:
        raise UntrustedError(
            "gyroscope: the image does not show the rotation that it measures (focal length "
            f"{value:.2g} ± {std:.2g} px). Its axes are probably permuted: x right, y down, z along the view; image "
            "axis y shows the rotation about x, and image axis x that about y."
        )


def _refuse_width(value: float, std: float, width: int) -> None:
    """UntrustedError for a focal length that no camera with pictures of this width (px) has; up to 1: not known."""
    low, high = (share * width for share in FOCAL_WIDTHS) if width > 1 else FOCAL_PX
    if not low < value < high:
        picture = f" in an image {width} px wide" if width > 1 else ""
        raise UntrustedError(
            f"gyroscope: by it the focal length is {value:.3g} ± {rounded(std)} px{picture}, which is implausible. "
            "Check gyroscope.unit: deg/s and rad/s differ by a factor of 57.3, deg/s and mdeg/s by 1000."
        )


def _fit_of(
    turning: Turning,
    focal: tuple[float, float],
    settled: Sequence[Settled],
    bias_std: float,
    scaled: Sequence[tuple[ScaleFactor, ScaleCalibration] | UntrustedError],
) -> GyroscopeFit:
    best = min(settled, key=lambda at: at.late_variance)
    density = turning.density
    if best.tells and np.log(best.place.density / density) > CERTAIN * best.place.doubt:
        # It is noisier in the band of the tilt than as declared, or than fast readings are.
        density = best.place.density
    fast, noise = turning.fast(density)
    tilt_px = focal[0] * max(fast, MIN_TILT * noise)
    slow_px, length_s = SLOW_TILT * tilt_px, float(turning.time_s[-1] - turning.time_s[0])
    # The mean holds what the camera has turned by from end to end.
    mean_std = float(np.hypot(np.sqrt(density / length_s), np.sqrt(2.0) * slow_px / focal[0] / length_s))
    drift2 = max(turning.drift**2 - (2.0 * CERTAIN * mean_std) ** 2, 0.0)
    text = (
        f"gyroscope: the camera tilts by {rounded(tilt_px)} px rms in the image above {SEEN_HZ:g} Hz, which the scale "
        f"factors are without; focal length {focal[0]:.4g} ± {rounded(focal[1])} px."
    )
    return GyroscopeFit(
        focal_px=focal[0],
        focal_std_px=focal[1],
        noise_rad_s=float(np.sqrt(density * turning.rate_hz)),
        bias_rad_s=turning.bias,
        bias_std_rad_s=float(np.sqrt(1.0 / (bias_std**-2.0 + mean_std**-2.0) + 0.25 * drift2)),
        # Means of both halves of a random walk differ by a third of its variance over all.
        bias_walk=max(BIAS_WALK, 3.0 * drift2 / length_s),
        offset_s=best.place.offset_s - best.place.turned_s,
        offset_std_s=float(np.sqrt(best.late_variance)),
        scales=tuple(None if isinstance(one, UntrustedError) else one[0] for one in scaled),
        found=tuple(None if isinstance(one, UntrustedError) else one[1] for one in scaled),
        reasons=tuple(str(one) if isinstance(one, UntrustedError) else "" for one in scaled),
        tilt_std_px=tilt_px,
        slow_tilt_px=slow_px,
        notices=(Notice("tilt", text), *turning.notices),
    )
