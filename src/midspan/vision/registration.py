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
from operator import attrgetter

import numpy as np

from midspan import _core
from midspan._core import Pose
from midspan.checks import refuse
from midspan.errors import DataError
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.learning import PAD_PX, KeptSamples, learn_plane, sample
from midspan.vision.plane import Plane, best_smoothing_px, fine_lowpass_taps, first_plane
from midspan.vision.region import check_size
from midspan.vision.target import Motion, lost, translation_of
from midspan.vision.template import NEXT_PX, TemplateSettings, TemplateState, TemplateTracker
from midspan.vision.texture import noise_gains
from midspan.vision.tracker import MAX_LEARNING_FRAMES, AxisMotion, Tracker

_CERTAIN = np.zeros((4, 4))
KERNEL_BYTES = 24 << 20  # of kernels in one bank: all 64 phases of a region of 256 px, 16 of one of 512 px
SEED_CORRELATION = 0.4  # with four tenths of the target covered the correlation falls to about a half
MIN_PLACES, PATIENCE = 8, 4
MAJORITY = _core.MAJORITY  # of the target's information: less agrees by chance, or with what moves differently in it
SEED_PX = 1.5  # farther than this from where the template was found, blocks have locked on something else
WHOLE_CORRELATION, WHOLE_PX, WHOLE_SHARE = 0.6, 0.05, 0.1


@dataclass(frozen=True, slots=True)
class RegistrationSettings:
    """Settings of the registration tracker.

    smoothing_px: Gaussian low-pass of the kernels on top of the one at the Nyquist frequency, 0 to 3 px; more suits
    weak or aliased texture; None sets it from the signal-to-noise ratio.
    search_px: how far from its last place the target is looked for without a prediction, 3 px or more.
    min_share: share of the target's information below which it counts as lost, 0 to 1.
    learn_frames: the template is made anew from this many frames, less noisy than the first alone and, where they show
    the target at many sub-pixel places, without its aliasing; 0: never on its own.
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
class Learned:
    """What was learned: the template; where the zero lies in it (4,): x, y (px), roll (rad), zoom, to be taken off; and
    the covariance (4, 4) of the zero, which rests on the reference frame alone.
    """

    plane: Plane
    zero: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationState(Motion):
    """What the tracker remembers besides: roll (rad), zoom, the usual noise of an undisturbed frame and how many frames
    it rests on, those kept to learn from, what was learned.
    """

    roll_rad: float = 0.0
    zoom: float = 0.0
    usual_noise: float = 0.0
    judged_frames: int = 0
    samples: KeptSamples | None = None
    learned: Learned | None = None


# What of a state the core remembers: all but the samples and what was learned.
_memory = attrgetter(*(one.name for one in fields(RegistrationState)[:-2]))


class RegistrationTracker(Tracker):
    """Follows a target through frames; see `midspan.vision.tracker.Tracker` for its interface.

    The core does what a usual frame needs (`core/src/track/tracker.rs`); here are the search and the learning.
    """

    _state: RegistrationState
    core: _core.Registration

    def __init__(self, reference: Frame, region: Region, settings: RegistrationSettings) -> None:
        super().__init__(reference, region)
        self.settings = settings
        self._seed = TemplateTracker(
            reference, region, TemplateSettings(search_px=settings.search_px, min_correlation=SEED_CORRELATION)
        )
        template = self._seed.template
        self._window, self._offset = template.window, template.offset
        self._first = first_plane(reference.pixels, template.window, template.offset)
        self._samples = self._begun()
        self._plane: Plane | None = None
        self._learned: Learned | None = None
        self._take(self._first, np.zeros(4), _CERTAIN)

    @property
    def kernel_bytes(self) -> int:
        """How many bytes of memory the kernels of the blocks take at most."""
        return self.core.most_kernel_bytes

    @property
    def settled(self) -> bool:  # type: ignore[override]
        """Whether nothing more is to be learned."""
        return self._samples is None

    @property
    def state(self) -> RegistrationState:
        """Everything that changes from frame to frame."""
        return RegistrationState(*self.core.state, self._samples, self._learned)

    def restore(self, state: RegistrationState) -> None:
        """Continue from a `state` taken earlier."""
        learned = state.learned
        plane = self._first if learned is None else learned.plane
        if plane is not self._plane:
            if learned is None:
                self._take(plane, np.zeros(4), _CERTAIN)
            else:
                self._take(plane, learned.zero, learned.covariance)
        self._samples, self._learned = state.samples, learned
        self.core.restore(_memory(state))

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) of the target in `frame`; LOST with NaN where it cannot be found."""
        check_size(frame, self.reference)
        row = self.core.track(frame.pixels, frame.time_ns, prediction)
        if row is None:
            return self.search(frame, prediction)
        if self.core.learnable:
            self.keep(frame)
        return translation_of(row)

    def search(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Find the target where the template is, as its expected place did not lead to it."""
        pose = self._found(frame, prediction, self.core.candidate)
        if pose is None:
            self.core.miss(self._seed.state.confused)
            return lost(frame.time_ns)
        row = self.core.accept(frame.time_ns, pose)
        if self.core.learnable:
            self.keep(frame)
        return translation_of(row)

    def keep(self, frame: Frame) -> None:
        """Keep a frame to learn from; with enough of them, at enough places, make the template anew."""
        if self._samples is None:
            return
        samples, enough = self._with(self._samples, frame), self.settings.learn_frames
        if samples is self._samples:
            return
        self._samples = samples
        varied = len(samples.items) >= MIN_PLACES
        if samples.frames < enough or not (varied or samples.frames == PATIENCE * enough):
            return
        # A structure at rest shows one place alone: an average will do until it moves.
        self._samples, self._learned = None if varied else samples, self._made_anew(samples)

    def _learn(self, frames: Sequence[Frame], motion: AxisMotion | None) -> Learned:
        """Make the template anew from frames that show the target, best at many sub-pixel places.

        The zero stays where it is for these frames, within their noise. `motion` is ignored: the tracker's own
        translations are more exact.
        """
        step = max(1, math.ceil(len(frames) / MAX_LEARNING_FRAMES))
        other = RegistrationTracker(self.reference, self.region, replace(self.settings, learn_frames=0))
        samples = KeptSamples()
        for frame in frames[::step]:
            other.push(frame)
            if other.core.learnable:
                samples = other._with(samples, frame)
        if samples.frames < 5:
            raise DataError(
                f"Learning needs at least 5 frames that show the target undisturbed; received {samples.frames}."
            )
        learned = other._made_anew(samples)
        self.restore(replace(self.state, samples=None, learned=learned))
        return learned

    def _begun(self) -> KeptSamples | None:
        """The reference frame as the first to learn from; None where nothing is to be learned."""
        if self.settings.learn_frames < 2:
            return None
        first = sample(self.reference.pixels, self._window, (0.0, 0.0), self._offset, None)
        return None if first is None else KeptSamples().plus(first)

    def _take(self, plane: Plane, zero: Floats, covariance: Floats) -> None:
        """Compare frames with this template from now on, poses counted from its `zero` (4,), known to `covariance`."""
        given = self.settings.smoothing_px
        smoothing_px = best_smoothing_px(plane, self._window) if given is None else given
        before = None if self._plane is None else self.core.state
        self._plane = plane
        self.core = _core.Registration(
            self._seed.template.matcher,
            grid=plane.grid,
            origin=plane.origin,
            weight=plane.weight,
            taps=fine_lowpass_taps(smoothing_px),
            gradient_noise=2.0 * plane.noise_std**2 * noise_gains(smoothing_px)[1],
            # Frame and template both have noise.
            difference_noise=math.sqrt(2.0) * plane.noise_std,
            min_share=self.settings.min_share,
            reference_noise=self._first.noise_std,
            floor_px2=self.settings.bias_floor_px**2,
            level=self._offset,
            shape=self.reference.pixels.shape,
            kernel_bytes=KERNEL_BYTES,
        )
        self.core.count_from(zero, covariance)
        if before is not None:
            self.core.restore(before)

    def _with(self, samples: KeptSamples, frame: Frame) -> KeptSamples:
        """The samples with one more, of a frame that the core has found the target in undisturbed."""
        like = samples.items[0].pixels if samples.items else None
        new = sample(frame.pixels, self._window, self.core.state[:2], self._offset, like)
        return samples if new is None else samples.plus(new)

    def _made_anew(self, samples: KeptSamples) -> Learned:
        """Take the template of the samples, its zero such that their mean place is where the first template put it."""
        plane = learn_plane(samples)
        if len(samples.items) < MIN_PLACES:
            # So few means are fitted without a rest, which says nothing of their noise.
            least = self._first.noise_std / math.sqrt(samples.frames)
            plane = replace(plane, noise_std=max(plane.noise_std, least))
        self._take(plane, np.zeros(4), _CERTAIN)
        zero = self._moved(samples, of_window=True)
        # The reference is one frame; the template's own noise is that of a frame over the root of their number.
        own = np.array(self.core.covariance(zero is not None)) * plane.noise_std**2 * samples.frames
        if zero is None:
            zero = self._moved(samples, of_window=False)
        learned = Learned(plane, np.zeros(4) if zero is None else zero, np.zeros((4, 4)))
        learned.covariance[:2, :2] = own
        self.core.count_from(learned.zero, learned.covariance)
        return learned

    def _moved(self, samples: KeptSamples, *, of_window: bool) -> Floats | None:
        """How much farther (4,) the samples lie in the template than they were put, in the mean; None: in none.

        of_window: by the window as a whole, else by its large blocks.
        """
        total, count = np.zeros(4), 0
        for item in samples.items:
            found = self.core.pose_in(item.pixels, (PAD_PX, PAD_PX), (*item.shift, 0.0, 0.0), of_window)
            if found is not None:
                total[:2] += item.count * (np.array([found.x_px, found.y_px]) - item.shift)
                count += item.count
        return total / count if count else None

    def _found(self, frame: Frame, prediction: Prediction | None, pose: Pose | None) -> Pose | None:
        """From where the template is found; `pose`: what was found at the expected place, None: nothing."""
        core, motion = self.core, Motion(*self.core.state[:7])
        self._seed.restore(TemplateState(*core.state[:7]))
        pose = pose if pose is not None and self._is_target(pose, frame, prediction, motion) else None
        if pose is not None and pose.share > MAJORITY and core.is_trusted(pose):
            return pose
        found = self._seed.push(frame, prediction)
        if found.status is Status.LOST:
            return pose if pose is not None and core.is_trusted(pose) else None
        other = core.look(frame.pixels, (found.x_px, found.y_px))
        if other is None or math.hypot(other.x_px - found.x_px, other.y_px - found.y_px) > SEED_PX:
            return self._whole(found)
        few = pose is not None and pose.share < MAJORITY < other.share
        return pose if pose is not None and pose.noise < other.noise and not few else other

    def _is_target(self, pose: Pose, frame: Frame, prediction: Prediction | None, motion: Motion) -> bool:
        """Whether a pose is that of the target, and not of a place that looks like it."""
        expected, place = motion.expected(frame.time_ns, prediction), np.array([pose.x_px, pose.y_px])
        if math.hypot(pose.x_px - expected[0], pose.y_px - expected[1]) <= NEXT_PX:
            return True
        return self._seed.identified(frame, place, prediction, motion) is place

    def _whole(self, found: PixelTranslation) -> Pose | None:
        """What the template as a whole says where its blocks do not agree: pictures that change all over.

        Only where it is as alike as the template tracker asks for. Half a block's disagreement is added.
        """
        if found.quality < WHOLE_CORRELATION * self._seed.expected_correlation:
            return None
        value = found.x_px, found.y_px, *self.core.state[7:9]
        variance = found.variance_x_px2 + WHOLE_PX**2, found.variance_y_px2 + WHOLE_PX**2, 1e-6, 1e-6
        return Pose(value, variance, WHOLE_SHARE, self.core.suspicious_noise)
