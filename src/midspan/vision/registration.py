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
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.average import Average, registered, start
from midspan.vision.bank import COARSE, FINE, Bank, Plane, first_plane
from midspan.vision.blocks import fuse, gains
from midspan.vision.kernels import PHASES, places
from midspan.vision.matching import Matching, make_template
from midspan.vision.region import check_size, clamp, shift
from midspan.vision.template import TemplateSettings, TemplateState, TemplateTracker
from midspan.vision.texture import values

MOST_PASSES = 8
LINEAR_PX = 0.5 / PHASES + 0.01  # a block this near to its kernels' phase needs no other
SEED_CORRELATION = 0.4  # with four tenths of the target covered the correlation falls to about a half
SINGLE_SMOOTHING_PX, LEARNT_SMOOTHING_PX = 0.7, 0.3
PAD_PX = 8  # around the window in an average: what low-pass and spline reach for
LEARN_SHARE = 0.8  # of the target's information must agree in a frame that is learnt from
UNDISTURBED_SHARE = 0.8
DISTURBED = 1.35  # times the usual noise: 30 degrees of freedom exceed it about once in 500 frames
CLEARLY_LESS = 0.8
SUSPICIOUS = 4.0  # times the usual noise
SEED_PX = 1.5  # farther than this from where the template was found, blocks have locked on something else
OWN_WEIGHT = 1.0  # of a frame's own noise against the usual one
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
    """What the tracker remembers: last translation (px), roll (rad), zoom, time, speed (px/s), lost frames, the
    usual noise of an undisturbed frame, and the average of the frames learnt so far.
    """

    x_px: float = 0.0
    y_px: float = 0.0
    roll_rad: float = 0.0
    zoom: float = 0.0
    time_ns: int | None = None
    speed_x_px_s: float = 0.0
    speed_y_px_s: float = 0.0
    lost_frames: int = 0
    usual_noise: float = 0.0
    average: Average | None = None


@dataclass(frozen=True, slots=True)
class Pose:
    """What one frame gives: x, y (px), roll (rad), zoom and their covariance (4, 4); share of the information used;
    noise of a pixel as the blocks' scatter shows it.
    """

    value: Floats
    covariance: Floats
    share: float
    noise: float

    def averaged(self, usual: float) -> "Pose":
        """With the noise averaged with the `usual` noise of earlier frames, that few blocks show only roughly."""
        if usual <= 0.0:
            return self
        square = (OWN_WEIGHT * self.noise**2 + usual**2) / (OWN_WEIGHT + 1.0)
        return replace(self, covariance=self.covariance * (square / max(self.noise, 1e-300) ** 2))

    def since(self, zero: "Pose") -> "Pose":
        """This pose counted from `zero`, whose uncertainty is added."""
        return replace(self, value=self.value - zero.value, covariance=self.covariance + zero.covariance)


@dataclass(frozen=True, slots=True)
class Learnt:
    """What comes of a complete average: kernels in few and in many blocks, and where the reference lies in each."""

    average: Average
    banks: tuple[Bank, Bank]
    zeros: tuple[Pose, Pose]


_AT_REST = Pose(np.zeros(4), np.zeros((4, 4)), 1.0, 0.0)


class RegistrationTracker:
    """Follows a target through frames; see `midspan.vision.tracker.Tracker` for its interface."""

    def __init__(self, reference: Frame, region: Region, settings: RegistrationSettings) -> None:
        self.settings = settings
        self._seed = TemplateTracker(
            reference, region, TemplateSettings(search_px=settings.search_px, min_correlation=SEED_CORRELATION)
        )
        template = make_template(reference.pixels, region, Matching(0.0, SEED_CORRELATION))
        self._window, self._offset = template.window, template.offset
        self._plane = first_plane(reference.pixels, template.window, template.offset)
        self._first = self._banks(self._plane, SINGLE_SMOOTHING_PX)
        self._learnt: Learnt | None = None
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
    def banks(self) -> tuple[Bank, Bank]:
        """The kernels in use: in few large blocks and in many small ones."""
        return self._first if self._learnt is None else self._learnt.banks

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
        check_size(frame, self.reference)
        pose = self._find(frame, prediction)
        self._state = _after(self._state, frame.time_ns, pose)
        if pose is None:
            nan = math.nan
            return PixelTranslation(frame.time_ns, nan, nan, nan, nan, 0.0, Status.LOST)
        x, y = (float(v) for v in pose.value[:2])
        var_x, var_y = (float(pose.covariance[k, k]) + self.settings.bias_floor_px**2 for k in range(2))
        self._learn(frame, pose)
        return PixelTranslation(frame.time_ns, x, y, var_x, var_y, pose.share, Status.TRACKING)

    def _smoothing(self, usual_px: float) -> float:
        return usual_px if self.settings.smoothing_px is None else self.settings.smoothing_px

    def _banks(self, plane: Plane, smoothing_px: float) -> tuple[Bank, Bank]:
        """Kernels in few large blocks, the most exact, and in many small ones, the most robust."""
        smoothing_px = self._smoothing(smoothing_px)
        return Bank(plane, self._window, smoothing_px, COARSE), Bank(plane, self._window, smoothing_px, FINE)

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
        box = (
            window.y - PAD_PX,
            window.y + window.height + PAD_PX,
            window.x - PAD_PX,
            window.x + window.width + PAD_PX,
        )
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
        if self._learnt is not None and self._learnt.average is average:
            return
        weight = average.weight()[PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]
        noise = self._plane.noise_std / math.sqrt(average.count)
        plane = Plane(average.mean, PAD_PX, PAD_PX, np.ascontiguousarray(weight), noise)
        banks = self._banks(plane, LEARNT_SMOOTHING_PX)
        image, offset = self._usable(self.reference.pixels)
        assert image is not None
        zeros = [self._climb(bank, image, offset, np.zeros(4)) for bank in banks]
        if zeros[0] is not None and zeros[1] is not None:
            self._learnt = Learnt(average, banks, (zeros[0], zeros[1]))

    def _look(self, image: NDArray[np.generic], offset: float, begin: Floats) -> Pose | None:
        """The pose since the reference frame, from large blocks or, where they disagree, from small ones."""
        banks = self.banks
        zeros = (_AT_REST, _AT_REST) if self._learnt is None else self._learnt.zeros
        usual = self._state.usual_noise
        few = self._climb(banks[0], image, offset, begin)
        if few is not None and few.share > UNDISTURBED_SHARE and few.noise < DISTURBED * usual:
            return few.averaged(usual).since(zeros[0])
        many = self._climb(banks[1], image, offset, begin)
        if many is None or few is None:
            return many.since(zeros[1]) if many is not None else few and few.since(zeros[0])
        spread = [float(p.covariance[0, 0] + p.covariance[1, 1]) for p in (few, many)]
        return many.since(zeros[1]) if spread[1] < CLEARLY_LESS * spread[0] else few.since(zeros[0])

    def _find(self, frame: Frame, prediction: Prediction | None) -> Pose | None:
        """Climb from the expected place; where that does not lead to the target, from where the template is found."""
        image, offset = self._usable(frame.pixels)
        if image is None:
            return None
        begin = np.array([*self._expected(frame.time_ns, prediction), self._state.roll_rad, self._state.zoom])
        pose = self._look(image, offset, begin) if self._state.lost_frames == 0 else None
        if pose is not None and self._trusted(pose):
            return pose
        state = self._state
        self._seed.restore(TemplateState(state.x_px, state.y_px, state.time_ns, lost_frames=state.lost_frames))
        found = self._seed.push(frame, prediction)
        if found.status is Status.LOST:
            return None
        other = self._look(image, offset, np.array([found.x_px, found.y_px, begin[2], begin[3]]))
        if other is None or math.hypot(other.value[0] - found.x_px, other.value[1] - found.y_px) > SEED_PX:
            return None
        return pose if pose is not None and pose.noise < other.noise else other

    def _trusted(self, pose: Pose) -> bool:
        """Whether the blocks agree as well as noise lets them: at a wrong place they do not."""
        # Frame and template both have noise.
        return pose.noise < SUSPICIOUS * max(self._state.usual_noise, math.sqrt(2.0) * self._plane.noise_std)

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
        for turn in range(MOST_PASSES):
            # Far from the kernels' phase the steps are not linear: only then may the blocks differ by more than noise.
            usual = self._state.usual_noise if turn > 1 else 0.0
            place = places(pose, bank.centres)
            sums, at = bank.measure(image, offset, place)
            gain = gains(sums[:, 2], bank.gain_information)
            usable = np.isfinite(sums[:, 0]) & (gain > GAINS[0]) & (gain < GAINS[1])
            step = sums[:, :2] / np.where(usable, gain, 1.0)[:, None]
            information = np.where(usable[:, None, None], bank.information, 0.0)
            found = np.where(usable[:, None], at + step, 0.0)
            value, covariance, weight, scale = fuse(found, information, bank.centres, pose, usual)
            if not np.isfinite(scale) or abs(value[2]) > LARGEST_ROLL_RAD or abs(value[3]) > LARGEST_ZOOM:
                return None
            total = bank.information[:, 0, 0] + bank.information[:, 1, 1]
            share = float(np.sum(weight * total) / np.sum(total))
            pose, place = value, places(value, bank.centres)
            result = Pose(value, covariance, share, float(scale))
            off = float(np.abs(place - at).max())
            if off < LINEAR_PX and (turn > 1 or share > UNDISTURBED_SHARE):
                break
        else:
            if off > 2.0 * LINEAR_PX:
                return None
        return result if result is not None and result.share >= self.settings.min_share else None


def _after(state: RegistrationState, time_ns: int, pose: Pose | None) -> RegistrationState:
    """The state after a frame: the speed is only kept between two frames that were both tracked."""
    if pose is None:
        return replace(state, speed_x_px_s=0.0, speed_y_px_s=0.0, lost_frames=state.lost_frames + 1)
    x, y, roll, zoom = (float(v) for v in pose.value)
    vx, vy = 0.0, 0.0
    if state.time_ns is not None and state.lost_frames == 0 and time_ns > state.time_ns:
        elapsed_s = (time_ns - state.time_ns) * 1e-9
        vx, vy = (x - state.x_px) / elapsed_s, (y - state.y_px) / elapsed_s
    usual = state.usual_noise
    # Noise below the usual counts quickly, noise above it slowly: a long disturbance does not become the usual.
    usual = pose.noise if usual == 0.0 else usual + (0.1 if pose.noise < 1.2 * usual else 0.005) * (pose.noise - usual)
    return RegistrationState(x, y, roll, zoom, time_ns, vx, vy, 0, usual, state.average)
