"""Registration tracker: maximum-likelihood kernels in blocks, fused into translation, roll and zoom.

The core multiplies the window by kernels made for the template at the nearest eighth of a pixel and fuses what its
blocks give, so that what covers, shades, turns or enlarges a part of the target does not move the result (see
`core/src/track/registration.rs`). The template is the reference frame at first; frames that show the target at other
sub-pixel places make a better one (see `midspan.vision.learning`) with the same zero. Where the expected place does not
lead to the target, the template tracker looks for it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan._core import Pose
from midspan.checks import option, refuse
from midspan.errors import DataError
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.learning import PAD_PX, KeptSamples, learn_plane, sample
from midspan.vision.plane import Plane, best_smoothing_px, fine_lowpass_taps, first_plane
from midspan.vision.region import check_size
from midspan.vision.target import FULL_QUALITY, Motion, lost
from midspan.vision.template import NEXT_PX, TemplateSettings, TemplateState, TemplateTracker
from midspan.vision.texture import noise_gains, values
from midspan.vision.tracker import Tracker

_CERTAIN = np.zeros((4, 4))
KERNEL_BYTES = 24 << 20  # of kernels in one bank: all 64 phases of a region of 256 px, 16 of one of 512 px
SEED_CORRELATION = 0.4  # with four tenths of the target covered the correlation falls to about a half
LEARN_SHARE = 0.7  # of the target's information must agree in a frame that is learnt from
LEARN_TURN_PX = 0.03  # at the window's edge: more roll or zoom would blur what is learnt
FEWEST_PLACES, PATIENCE = 8, 4
MOST_LEARNT_FRAMES = 240
SUSPICIOUS = 4.0  # times the usual noise
MAJORITY = 0.5  # of the target's information: less agrees by chance, or with what moves differently in the region
SEED_PX = 1.5  # farther than this from where the template was found, blocks have locked on something else
LEAST_NOISE = 0.5  # of the reference's: less is a picture without noise, whose blocks differ by aliasing
SELF_SHARE = 0.05  # of the reference's noise: a frame that agrees better than this is the reference itself
WHOLE_CORRELATION, WHOLE_PX, WHOLE_SHARE = 0.6, 0.05, 0.1


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """Settings of the registration tracker.

    smoothing_px: Gaussian low-pass of the kernels on top of the one at the Nyquist frequency, 0 to 3 px; more suits
    weak or aliased texture; None sets it from the signal-to-noise ratio.
    search_px: how far from its last place the target is looked for without a prediction, 3 px or more.
    min_share: share of the target's information below which it counts as lost, 0 to 1.
    learn_frames: the template is made anew from this many frames, less noisy than the first alone and, where they show
    the target at many sub-pixel places, without its aliasing; 0: never by itself.
    bias_floor_px: standard deviation added for what interpolation and aliasing get wrong, 0 px or more.
    """

    smoothing_px: float | None = None
    search_px: float = 48.0
    min_share: float = 0.2
    learn_frames: int = 48
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
class Learnt:
    """What was learnt: the template; where the zero lies in it (4,): x, y (px), roll (rad), zoom, to be taken off; and
    the covariance (4, 4) of the zero, which rests on the reference frame alone.
    """

    plane: Plane
    zero: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationState(Motion):
    """What the tracker remembers besides: roll (rad), zoom, the usual noise of an undisturbed frame and how many frames
    it rests on, those kept to learn from, what was learnt.
    """

    roll_rad: float = 0.0
    zoom: float = 0.0
    usual_noise: float = 0.0
    judged_frames: int = 0
    samples: KeptSamples | None = None
    learnt: Learnt | None = None


class RegistrationTracker(Tracker):
    """Follows a target through frames; see `midspan.vision.tracker.Tracker` for its interface."""

    _state: RegistrationState

    def __init__(self, reference: Frame, region: Region, settings: RegistrationSettings) -> None:
        super().__init__(reference, region)
        self.settings, self._floor_px2 = settings, settings.bias_floor_px**2
        self._seed = TemplateTracker(
            reference, region, TemplateSettings(search_px=settings.search_px, min_correlation=SEED_CORRELATION)
        )
        template = self._seed.template
        self._window, self._offset = template.window, template.offset
        self._first = first_plane(reference.pixels, template.window, template.offset)
        self._state = RegistrationState(samples=self._begun())
        self._take(self._first, np.zeros(4), _CERTAIN)

    @property
    def kernel_bytes(self) -> int:
        """How many bytes of memory the kernels of the blocks take at most."""
        return self._core.most_kernel_bytes

    @property
    def _usual(self) -> float:
        """The noise to be expected of a frame, 0 while none has shown it."""
        shown = self._state.usual_noise
        return max(shown, LEAST_NOISE * self._first.noise_std) if shown > 0.0 else 0.0

    def restore(self, state: RegistrationState) -> None:
        """Continue from a `state` taken earlier."""
        self._state, learnt = state, state.learnt
        plane = self._first if learnt is None else learnt.plane
        if plane is not self._plane:
            if learnt is None:
                self._take(plane, np.zeros(4), _CERTAIN)
            else:
                self._take(plane, learnt.zero, learnt.covariance)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN where it cannot be found."""
        check_size(frame, self.reference)
        pose = self._find(frame, prediction)
        if pose is None:
            self._state = self._state.missed(confused=self._seed.state.confused)
            return lost(frame.time_ns)
        self._state = _after(self._state, frame.time_ns, pose, self._first.noise_std)
        if self._state.samples is not None:
            self._keep(frame, pose, self._state.samples)
        share, floor_px2 = pose.share, self._floor_px2
        var_x, var_y = pose.variance_x_px2 + floor_px2, pose.variance_y_px2 + floor_px2
        return PixelTranslation(
            frame.time_ns, pose.x_px, pose.y_px, var_x, var_y, share, Status.TRACKING, FULL_QUALITY * share
        )

    def learn(
        self,
        frames: Sequence[Frame],
        translation_px: Floats | None = None,
        *,
        direction: str = "y",
        band_hz: tuple[float, float] | None = None,
    ) -> Learnt:
        """Make the template anew from frames that show the target, best at many sub-pixel places.

        The zero stays where it is for these frames, within their noise. All but the frames is taken so that all
        trackers that learn are called alike; the tracker's own translations are the more exact. Returns what is now in
        use. Raises DataError where fewer than 5 frames show the target undisturbed.
        """
        option("direction", direction, ("x", "y"))
        step = max(1, math.ceil(len(frames) / MOST_LEARNT_FRAMES))
        other = RegistrationTracker(self.reference, self.region, replace(self.settings, learn_frames=0))
        samples = KeptSamples()
        for frame in frames[::step]:
            check_size(frame, self.reference)
            found = other._find(frame, None)
            if found is None:
                other._state = other._state.missed(confused=other._seed.state.confused)
                continue
            other._state = _after(other._state, frame.time_ns, found, other._first.noise_std)
            samples = other._with(samples, frame, found)
        if samples.frames < 5:
            raise DataError(
                f"Learning needs at least 5 frames that show the target undisturbed; received {samples.frames}."
            )
        learnt = other._learnt(samples)
        self.restore(replace(self._state, samples=None, learnt=learnt))
        return learnt

    def _begun(self) -> KeptSamples | None:
        """The reference frame as the first to learn from; None where nothing is to be learnt."""
        if self.settings.learn_frames < 2:
            return None
        first = sample(self.reference.pixels, self._window, (0.0, 0.0), self._offset, None)
        return None if first is None else KeptSamples().plus(first)

    def _take(self, plane: Plane, zero: Floats, covariance: Floats) -> None:
        """Compare frames with this template from now on, poses counted from its `zero` (4,), known to `covariance`."""
        given = self.settings.smoothing_px
        smoothing_px = best_smoothing_px(plane, self._window) if given is None else given
        # Frame and template both have noise.
        self._plane, self._difference_noise = plane, math.sqrt(2.0) * plane.noise_std
        self._core = _core.Registration(
            self._seed.template.matcher,
            grid=plane.grid,
            origin=plane.origin,
            weight=plane.weight,
            taps=fine_lowpass_taps(smoothing_px),
            gradient_noise=2.0 * plane.noise_std**2 * noise_gains(smoothing_px)[1],
            min_share=self.settings.min_share,
            reference_noise=self._first.noise_std,
            kernel_bytes=KERNEL_BYTES,
        )
        self._core.count_from(zero, covariance)

    def _with(self, samples: KeptSamples, frame: Frame, pose: Pose) -> KeptSamples:
        """The samples with one more where it shows the target undisturbed, neither turned nor enlarged."""
        far = 0.5 * math.hypot(self._window.width, self._window.height)
        turns = (pose.roll_rad, pose.variance_roll_rad2), (pose.zoom, pose.variance_zoom)
        straight = all(far * abs(turn) <= LEARN_TURN_PX + 3.0 * far * math.sqrt(variance) for turn, variance in turns)
        if pose.share < LEARN_SHARE or not straight:
            return samples
        like = samples.items[0].pixels if samples.items else None
        new = sample(frame.pixels, self._window, (pose.x_px, pose.y_px), self._offset, like)
        return samples if new is None else samples.plus(new)

    def _keep(self, frame: Frame, pose: Pose, before: KeptSamples) -> None:
        """Keep a frame to learn from; with enough of them, at enough places, make the template anew."""
        samples, enough = self._with(before, frame, pose), self.settings.learn_frames
        if samples is before:
            return
        self._state = replace(self._state, samples=samples)
        varied = len(samples.items) >= FEWEST_PLACES
        if samples.frames < enough or not (varied or samples.frames == PATIENCE * enough):
            return
        # A structure at rest shows one place alone: an average will do until it moves.
        self._state = replace(self._state, samples=None if varied else samples, learnt=self._learnt(samples))

    def _learnt(self, samples: KeptSamples) -> Learnt:
        """Take the template of the samples, its zero such that their mean place is where the first template put it."""
        plane = learn_plane(samples)
        if len(samples.items) < FEWEST_PLACES:
            # So few means are fitted without a rest, which says nothing of their noise.
            least = self._first.noise_std / math.sqrt(samples.frames)
            plane = replace(plane, noise_std=max(plane.noise_std, least))
        self._take(plane, np.zeros(4), _CERTAIN)
        zero = self._moved(samples, of_window=True)
        # The reference is one frame; the template's own noise is that of a frame over the root of their number.
        own = np.array(self._core.covariance(zero is not None)) * plane.noise_std**2 * samples.frames
        if zero is None:
            zero = self._moved(samples, of_window=False)
        learnt = Learnt(plane, np.zeros(4) if zero is None else zero, np.zeros((4, 4)))
        learnt.covariance[:2, :2] = own
        self._core.count_from(learnt.zero, learnt.covariance)
        return learnt

    def _moved(self, samples: KeptSamples, *, of_window: bool) -> Floats | None:
        """How much farther (4,) the samples lie in the template than they were put, in the mean; None: in none.

        of_window: by the window as a whole, else by its large blocks.
        """
        total, count = np.zeros(4), 0
        for item in samples.items:
            found = self._core.pose_in(item.pixels, (PAD_PX, PAD_PX), (*item.shift, 0.0, 0.0), of_window)
            if found is not None:
                total[:2] += item.count * (np.array([found.x_px, found.y_px]) - item.shift)
                count += item.count
        return total / count if count else None

    def _find(self, frame: Frame, prediction: Prediction | None) -> Pose | None:
        """Climb from the expected place; where that does not lead to the target, from where the template is found."""
        state = self._state
        expected = state.expected(frame.time_ns, prediction)
        image, offset = self._usable(frame.pixels, expected)
        if image is None:
            self._remind()
            return None
        usual, look = self._usual, self._core.look
        pose = look(image, offset, (*expected, state.roll_rad, state.zoom), usual) if state.lost_frames == 0 else None
        pose = pose if pose is not None and self._is_target(pose, expected, frame, prediction) else None
        if pose is not None and pose.share > MAJORITY and self._trusted(pose, usual):
            return pose
        self._remind()
        found = self._seed.push(frame, prediction)
        if found.status is Status.LOST:
            return pose if pose is not None and self._trusted(pose, usual) else None
        place = found.x_px, found.y_px
        image, offset = self._usable(frame.pixels, place)
        other = None if image is None else look(image, offset, (*place, state.roll_rad, state.zoom), usual)
        if other is None or math.hypot(other.x_px - found.x_px, other.y_px - found.y_px) > SEED_PX:
            return self._whole(found)
        few = pose is not None and pose.share < MAJORITY < other.share
        return pose if pose is not None and pose.noise < other.noise and not few else other

    def _remind(self) -> None:
        """Let the template tracker know of the motion so far."""
        self._seed.restore(TemplateState(**{f.name: getattr(self._state, f.name) for f in fields(Motion)}))

    def _is_target(
        self, pose: Pose, expected: tuple[float, float], frame: Frame, prediction: Prediction | None
    ) -> bool:
        """Whether a pose is that of the target, and not of a place that looks like it."""
        if math.hypot(pose.x_px - expected[0], pose.y_px - expected[1]) <= NEXT_PX:
            return True
        place = np.array([pose.x_px, pose.y_px])
        return self._seed.identified(frame, place, prediction, self._state) is place

    def _whole(self, found: PixelTranslation) -> Pose | None:
        """What the template as a whole says where its blocks do not agree: pictures that change all over.

        Only where it is as alike as the template tracker asks for. Half a block's disagreement is added.
        """
        if found.quality < WHOLE_CORRELATION * self._seed.expected_correlation:
            return None
        value = found.x_px, found.y_px, self._state.roll_rad, self._state.zoom
        variance = found.variance_x_px2 + WHOLE_PX**2, found.variance_y_px2 + WHOLE_PX**2, 1e-6, 1e-6
        return Pose(value, variance, WHOLE_SHARE, SUSPICIOUS * max(self._usual, self._first.noise_std))

    def _trusted(self, pose: Pose, usual: float) -> bool:
        """Whether the blocks agree as well as noise lets them: at a wrong place they do not."""
        return pose.noise < SUSPICIOUS * max(usual, self._difference_noise)

    def _usable(
        self, pixels: NDArray[np.generic], expected: tuple[float, float]
    ) -> tuple[NDArray[np.generic] | None, float]:
        """The pixels and what is to be subtracted of them; holes about the place are filled, None: too many."""
        if pixels.dtype.kind != "f" or self._core.all_finite(pixels, *expected):
            return pixels, self._offset
        return values(pixels, self._offset), 0.0


def _after(state: RegistrationState, time_ns: int, pose: Pose, noise_std: float) -> RegistrationState:
    """The state after a frame that shows the target."""
    x, y = pose.x_px, pose.y_px
    usual, judged = _judged(state, pose.noise, noise_std)
    speed_x, speed_y = state.speed_to(time_ns, x, y)
    return RegistrationState(
        x, y, time_ns, speed_x, speed_y, 0, False, pose.roll_rad, pose.zoom, usual, judged, state.samples, state.learnt
    )


def _judged(state: RegistrationState, noise: float, noise_std: float) -> tuple[float, int]:
    """The usual noise renewed from that of one frame, and how many it rests on; `noise_std` is the reference's own."""
    usual, judged = state.usual_noise, state.judged_frames
    if noise < SELF_SHARE * noise_std:
        return usual, judged
    # Noise below the usual counts quickly, noise above it slowly: a long disturbance does not become the usual.
    share = max(0.1 if noise < 1.2 * usual else 0.005, 1.0 / (judged + 1))
    return usual + share * (noise - usual), judged + 1
