"""Registration tracker: maximum-likelihood kernels in blocks, fused robustly into translation, roll and zoom.

Each block of the window is multiplied by kernels made for the template at the nearest sixteenth of a pixel; that gives
its translation in one step (see `midspan.vision.kernels`). The blocks are fused so that what covers, shades, turns or
enlarges a part of the target does not move the result (see `midspan.vision.blocks`). Nothing of the frame is
interpolated. Where the expected place does not lead to the target, the template tracker looks for it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.errors import DataError
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.average import Average, registered, start
from midspan.vision.blocks import fuse
from midspan.vision.kernels import PHASES, build, phase_shift, places, project, quantised
from midspan.vision.matching import CONTEXT_PX, Matching, make_template
from midspan.vision.region import clamp, shift
from midspan.vision.spline import REACH, Floats32, coefficients, combine, weights
from midspan.vision.template import TemplateSettings, TemplateState, TemplateTracker
from midspan.vision.texture import lowpass_taps, noise_gains, noise_std, values

BLOCKS = 8  # along each axis, fewer where they would be smaller than
SMALLEST_BLOCK_PX = 10
MOST_PASSES = 8
LINEAR_PX = 0.5 / PHASES + 0.01  # a block this near to its kernels' phase needs no other
SEED_CORRELATION = 0.4  # with four tenths of the target covered the correlation falls to about a half
SINGLE_SMOOTHING_PX, LEARNT_SMOOTHING_PX = 0.7, 0.3
PAD_PX = 8  # around the window in an average: what low-pass and spline reach for
LEARN_SHARE = 0.8  # of the target's information must agree in a frame that is learnt from
LARGEST_ROLL_RAD, LARGEST_ZOOM = 0.1, 0.1
GAINS = (0.1, 10.0)


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """Settings of the registration tracker.

    smoothing_px: Gaussian low-pass of the kernels on top of the one at the Nyquist frequency, 0 to 3 px; more suits
    weak or aliased texture; None sets it from the signal-to-noise ratio.
    search_px: how far from its last place the target is looked for without a prediction, 3 px or more.
    min_share: share of the target's information below which it counts as lost, 0 to 1.
    learn_frames: the template becomes the average of this many frames, less noisy than the first alone; 0: never.
    bias_floor_px: standard deviation added for what interpolation and aliasing get wrong, 0 px or more.
    """

    smoothing_px: float | None = None
    search_px: float = 48.0
    min_share: float = 0.3
    learn_frames: int = 24
    bias_floor_px: float = 0.0005

    def __post_init__(self) -> None:
        if self.smoothing_px is not None and not 0.0 <= self.smoothing_px <= 3.0:
            raise refuse("smoothing_px", "from 0 to 3 px", self.smoothing_px)
        if not 3.0 <= self.search_px <= 1e6:
            raise refuse("search_px", "3 px or more", self.search_px)
        if not 0.0 < self.min_share < 1.0:
            raise refuse("min_share", "above 0 and below 1", self.min_share)
        if not 0 <= self.learn_frames <= 1000:
            raise refuse("learn_frames", "from 0 to 1000", self.learn_frames)
        if not 0.0 <= self.bias_floor_px < math.inf:
            raise refuse("bias_floor_px", "0 px or more", self.bias_floor_px)


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationState:
    """What the tracker remembers: last translation (px), roll (rad), zoom, time, speed (px/s), lost frames, and the
    average of the frames learnt so far.
    """

    x_px: float = 0.0
    y_px: float = 0.0
    roll_rad: float = 0.0
    zoom: float = 0.0
    time_ns: int | None = None
    speed_x_px_s: float = 0.0
    speed_y_px_s: float = 0.0
    lost_frames: int = 0
    average: Average | None = None


@dataclass(frozen=True, slots=True)
class Pose:
    """What one frame gives: x, y (px), roll (rad), zoom and their covariance (4, 4); share of the information used;
    noise against the expected one.
    """

    value: Floats
    covariance: Floats
    share: float
    scale: float
    gain: float


_AT_REST = Pose(np.zeros(4), np.zeros((4, 4)), 1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Plane:
    """What kernels are made from: `pixels` (rows, columns) around the window, which begins at `top`, `left` in it;
    `weight` (h, w) of the window's pixels; standard deviation of its noise.
    """

    pixels: Floats
    top: int
    left: int
    weight: Floats32
    noise_std: float


class Bank:
    """The kernels of a template for all phases, each made when it is first needed."""

    def __init__(self, plane: Plane, window: Region, smoothing_px: float) -> None:
        self.window = window
        self._grids = (_grid(plane, window, 0.0), _grid(plane, window, smoothing_px))
        self._weight = plane.weight
        self.edges = (_edges(window.height), _edges(window.width))
        down, across = (0.5 * (e[1:] + e[:-1]) for e in self.edges)
        x, y = np.meshgrid(across - 0.5 * window.width, down - 0.5 * window.height)
        self.centres = np.column_stack([x.ravel(), y.ravel()])
        self.kernels = np.empty((PHASES**2, 3, window.height, window.width), dtype=np.float32)
        self._made = np.zeros(PHASES**2, dtype=bool)
        covariance = self._build(PHASES // 2 * (PHASES + 1))
        noise = plane.noise_std**2 * noise_gains(smoothing_px)[1] * 2.0
        share = np.clip(1.0 - noise / np.maximum(_gradient_squares(self._grids[1], self.edges), 1e-30), 0.0, 1.0)
        self.information = _information(covariance, share)
        spread = np.where(np.isfinite(covariance[:, 2, 2]), covariance[:, 2, 2], np.inf)
        self.gain_information = np.where(self.information[:, 0, 0] > 0, 1.0 / np.maximum(spread, 1e-300), 0.0)

    def measure(self, image: NDArray[np.generic], offset: float, place: Floats) -> tuple[Floats, Floats]:
        """Products (blocks, 5) of the frame with the kernels nearest to the blocks' `place` (blocks, 2), and the
        translations (blocks, 2) that these kernels stand for.
        """
        whole, phase = quantised(place)
        for p in np.unique(phase):
            if not self._made[p]:
                self._build(int(p))
        at = (whole[:, 1] + self.window.y, whole[:, 0] + self.window.x, phase)
        return project(image, offset, self.kernels, self.edges, at), np.floor(place * PHASES + 0.5) / PHASES

    def _build(self, phase: int) -> Floats:
        self._made[phase] = True
        return build(self._grids, self._weight, self.edges, phase_shift(phase), self.kernels[phase])


def _edges(size: int) -> NDArray[np.int64]:
    count = min(BLOCKS, max(size // SMALLEST_BLOCK_PX, 2))
    return np.array([k * size // count for k in range(count + 1)], dtype=np.int64)


def _first_plane(image: NDArray[np.generic], window: Region, offset: float) -> Plane:
    """The reference image around the window, less `offset`; its values are known to be usable."""
    y0, x0 = max(window.y - CONTEXT_PX, 0), max(window.x - CONTEXT_PX, 0)
    raw = values(image[y0 : window.y + window.height + CONTEXT_PX, x0 : window.x + window.width + CONTEXT_PX], offset)
    assert raw is not None
    weight = np.ones((window.height, window.width), dtype=np.float32)
    return Plane(raw.astype(np.float64), window.y - y0, window.x - x0, weight, _block_noise(raw))


def _grid(plane: Plane, window: Region, smoothing_px: float) -> Floats32:
    """Spline coefficients over the window and 3 px around it, of the low-passed image where `smoothing_px` is not 0."""
    from scipy.ndimage import convolve1d

    pixels = plane.pixels
    if smoothing_px > 0.0:
        taps = lowpass_taps(smoothing_px)
        pixels = convolve1d(convolve1d(pixels, taps, axis=0, mode="mirror"), taps, axis=1, mode="mirror")
    top, left = plane.top - REACH, plane.left - REACH
    part = coefficients(pixels)[top : top + window.height + 2 * REACH, left : left + window.width + 2 * REACH]
    return np.ascontiguousarray(part, dtype=np.float32)


def _block_noise(raw: Floats32) -> float:
    """Noise of the image: the lower fifth of that of its parts, because fine texture counts as noise."""
    side = 16
    parts = [
        noise_std(raw[y : y + side, x : x + side].astype(np.float64))
        for y in range(0, raw.shape[0] - side + 1, side)
        for x in range(0, raw.shape[1] - side + 1, side)
    ]
    return float(np.quantile(parts, 0.2))


def _gradient_squares(grid: Floats32, edges: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Floats:
    """Mean of the squared gradient (blocks,), its level taken out."""
    value, slope = weights(0.0, 0), weights(0.0, 1)
    gx, gy = combine(grid, value, slope).astype(np.float64), combine(grid, slope, value).astype(np.float64)
    down, across = edges
    return np.array(
        [
            gx[r0:r1, c0:c1].var() + gy[r0:r1, c0:c1].var()
            for r0, r1 in zip(down[:-1], down[1:], strict=True)
            for c0, c1 in zip(across[:-1], across[1:], strict=True)
        ]
    )


def _information(covariance: Floats, share: Floats) -> Floats:
    """Inverse covariance (blocks, 2, 2) of x and y for noise of variance 1; 0 for blocks without texture."""
    out = np.zeros((len(covariance), 2, 2))
    for b, c in enumerate(covariance):
        if np.isfinite(c).all() and share[b] > 0.3:
            out[b] = np.linalg.inv(c[:2, :2]) * share[b]
    return out


def gains(found: Floats, information: Floats) -> Floats:
    """Gain (blocks,) of every block, drawn to the median of all as far as its own is uncertain.

    `found` (blocks,) gains, `information` (blocks,) their inverse variances up to a factor.
    """
    usable = np.isfinite(found) & (information > 0)
    if not usable.any():
        return np.full(len(found), np.nan)
    middle = float(np.median(found[usable]))
    square = (found[usable] - middle) ** 2
    # The scatter of equal gains gives the noise; what is more than twice that is their own difference.
    noise = float(np.median(square * information[usable])) / 0.455
    own = float(np.median(square)) / 0.455
    spread = max(own - noise * float(np.median(1.0 / information[usable])), 0.0)
    variance = noise / np.where(usable, information, 1.0)
    trust = spread / np.maximum(spread + variance, 1e-300)
    return np.where(usable, middle + trust * (found - middle), np.nan)


class RegistrationTracker:
    """Follows a target through frames; see `midspan.vision.tracker.Tracker` for its interface."""

    def __init__(self, reference: Frame, region: Region, settings: RegistrationSettings) -> None:
        self.settings = settings
        self._seed = TemplateTracker(
            reference, region, TemplateSettings(search_px=settings.search_px, min_correlation=SEED_CORRELATION)
        )
        template = make_template(reference.pixels, region, Matching(0.0, SEED_CORRELATION))
        self._window, self._offset = template.window, template.offset
        self._plane = _first_plane(reference.pixels, template.window, template.offset)
        self._first = Bank(self._plane, template.window, self._smoothing(SINGLE_SMOOTHING_PX))
        self._learnt: tuple[Average, Bank, Pose] | None = None
        self._state = RegistrationState(average=start(self._inner(self._plane)))

    @property
    def reference(self) -> Frame:
        """The frame that the translation counts from."""
        return self._seed.reference

    @property
    def region(self) -> Region:
        """The target's region in the reference frame."""
        return self._seed.region

    @property
    def region_now(self) -> Region:
        """Where the target was last seen, inside the image."""
        rows, columns = self.reference.pixels.shape
        return clamp(shift(self.region, self._state.x_px, self._state.y_px), columns, rows)

    @property
    def state(self) -> RegistrationState:
        """Everything that changes from frame to frame."""
        return self._state

    def restore(self, state: RegistrationState) -> None:
        """Continue from a `state` taken earlier."""
        self._state = state
        self._renew()

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN where it cannot be found."""
        if frame.pixels.shape != self.reference.pixels.shape:
            now, then = ("x".join(str(n) for n in p.shape[::-1]) for p in (frame.pixels, self.reference.pixels))
            raise DataError(
                f"All frames must have the size of the first ({then} px); frame {frame.index} has {now} px. "
                "Split the recording where the camera's format changed."
            )
        pose = self._find(frame, prediction)
        self._state = _after(self._state, frame.time_ns, pose)
        if pose is None:
            nan = math.nan
            return PixelTranslation(frame.time_ns, nan, nan, nan, nan, 0.0, Status.LOST)
        zero = self._learnt[2] if self._learnt is not None else _AT_REST
        x, y = (float(pose.value[k] - zero.value[k]) for k in range(2))
        floor = self.settings.bias_floor_px**2
        var_x, var_y = (float(pose.covariance[k, k] + zero.covariance[k, k]) + floor for k in range(2))
        self._learn(frame, pose)
        return PixelTranslation(frame.time_ns, x, y, var_x, var_y, pose.share, Status.TRACKING)

    def _smoothing(self, usual_px: float) -> float:
        return usual_px if self.settings.smoothing_px is None else self.settings.smoothing_px

    def _inner(self, plane: Plane) -> Floats:
        """The window of the plane with the margin of an average."""
        top, left = plane.top - PAD_PX, plane.left - PAD_PX
        h, w = self._window.height + 2 * PAD_PX, self._window.width + 2 * PAD_PX
        return plane.pixels[top : top + h, left : left + w]

    def _learn(self, frame: Frame, pose: Pose) -> None:
        """Add a frame to the average, until there are enough."""
        average, window = self._state.average, self._window
        if average is None or average.count >= self.settings.learn_frames or pose.share < LEARN_SHARE:
            return
        box = (window.y - PAD_PX, window.y + window.height + PAD_PX, window.x - PAD_PX, window.x + window.width + PAD_PX)
        moved = registered(frame.pixels, box, (float(pose.value[0]), float(pose.value[1])), self._offset)
        if moved is not None:
            self._state = replace(self._state, average=average.plus(moved))
            self._renew()

    def _renew(self) -> None:
        """Make the kernels anew from the average when it is complete; the zero stays at the reference frame."""
        average = self._state.average
        if average is None or average.count < max(self.settings.learn_frames, 2):
            self._learnt = None
            return
        if self._learnt is not None and self._learnt[0] is average:
            return
        weight = average.weight()[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]
        noise = self._plane.noise_std / math.sqrt(average.count)
        plane = Plane(average.mean, PAD_PX, PAD_PX, np.ascontiguousarray(weight), noise)
        bank = Bank(plane, self._window, self._smoothing(LEARNT_SMOOTHING_PX))
        image, offset = self._usable(self.reference.pixels)
        zero = None if image is None else self._climb(bank, image, offset, np.zeros(4))
        self._learnt = None if zero is None else (average, bank, zero)

    def _find(self, frame: Frame, prediction: Prediction | None) -> Pose | None:
        """Climb from the expected place; where that does not lead to the target, from where the template is found."""
        image, offset = self._usable(frame.pixels)
        if image is None:
            return None
        bank = self._learnt[1] if self._learnt is not None else self._first
        start = np.array([*self._expected(frame.time_ns, prediction), self._state.roll_rad, self._state.zoom])
        pose = self._climb(bank, image, offset, start) if self._state.lost_frames == 0 else None
        if pose is not None and pose.share > 0.8:
            return pose
        state = self._state
        self._seed.restore(
            TemplateState(state.x_px, state.y_px, state.time_ns, lost_frames=state.lost_frames)
        )
        found = self._seed.push(frame, prediction)
        if found.status is Status.LOST:
            return pose
        other = self._climb(bank, image, offset, np.array([found.x_px, found.y_px, start[2], start[3]]))
        return max((p for p in (pose, other) if p is not None), key=lambda p: p.share, default=None)

    def _usable(self, pixels: NDArray[np.generic]) -> tuple[NDArray[np.generic] | None, float]:
        if pixels.dtype == np.uint8:
            return pixels, self._offset
        return values(pixels, self._offset), 0.0

    def _expected(self, time_ns: int, prediction: Prediction | None) -> tuple[float, float]:
        state = self._state
        if prediction is not None and math.isfinite(prediction.x_px + prediction.y_px):
            x, y = prediction.x_px, prediction.y_px
        else:
            elapsed_s = 0.0 if state.time_ns is None else (time_ns - state.time_ns) * 1e-9
            x, y = state.x_px + state.speed_x_px_s * elapsed_s, state.y_px + state.speed_y_px_s * elapsed_s
        return min(max(x, -1e6), 1e6), min(max(y, -1e6), 1e6)

    def _climb(self, bank: Bank, image: NDArray[np.generic], offset: float, start: Floats) -> Pose | None:
        """Linear steps from `start` (4,) until every block lies at its kernels' phase."""
        pose = start
        result = None
        for _ in range(MOST_PASSES):
            place = places(pose, bank.centres)
            sums, at = bank.measure(image, offset, place)
            gain = gains(sums[:, 2], bank.gain_information)
            usable = np.isfinite(sums[:, 0]) & (gain > GAINS[0]) & (gain < GAINS[1])
            step = sums[:, :2] / np.where(usable, gain, 1.0)[:, None]
            information = np.where(usable[:, None, None], bank.information, 0.0)
            value, covariance, weight, scale = fuse(np.where(usable[:, None], at + step, 0.0), information, bank.centres)
            if not np.isfinite(scale) or abs(value[2]) > LARGEST_ROLL_RAD or abs(value[3]) > LARGEST_ZOOM:
                return None
            total = bank.information[:, 0, 0] + bank.information[:, 1, 1]
            share = float(np.sum(weight * total) / np.sum(total))
            result = Pose(value, covariance, share, float(scale), float(np.nanmedian(gain)))
            pose = value
            if np.abs(places(pose, bank.centres) - at).max() < LINEAR_PX:
                break
        else:
            return None
        return result if result.share >= self.settings.min_share else None


def _after(state: RegistrationState, time_ns: int, pose: Pose | None) -> RegistrationState:
    """The state after a frame: the speed is only kept between two frames that were both tracked."""
    if pose is None:
        return replace(state, speed_x_px_s=0.0, speed_y_px_s=0.0, lost_frames=state.lost_frames + 1)
    x, y, roll, zoom = (float(v) for v in pose.value)
    vx, vy = 0.0, 0.0
    if state.time_ns is not None and state.lost_frames == 0 and time_ns > state.time_ns:
        elapsed_s = (time_ns - state.time_ns) * 1e-9
        vx, vy = (x - state.x_px) / elapsed_s, (y - state.y_px) / elapsed_s
    return RegistrationState(x, y, roll, zoom, time_ns, vx, vy, 0, state.average)
