"""What all trackers share, and the table of their names."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan._core import Registration
from midspan.checks import instance, option, refuse
from midspan.errors import DataError
from midspan.records import Floats, Frame, PixelTranslation, Prediction, Region
from midspan.vision.region import check_region, clamp, region_of, shift

if TYPE_CHECKING:
    from midspan.vision.active_pixels import ActivePixels


AXES = ("x", "y")
MAX_LEARNING_FRAMES = 240  # that a tracker learns from: more take longer and tell little that is new


@dataclass(frozen=True, slots=True, eq=False)
class AxisMotion:
    """Motion of a target along an image axis as another sensor shows it: translation_px (n,) of n frames, from any zero
    and without drift; axis: its number, 0 along x; band_hz: to be compared within this band only, None: in any.
    """

    translation_px: Floats
    axis: int
    band_hz: tuple[float, float] | None = None

    def part(self, which: Sequence[int] | slice) -> "AxisMotion":
        """That of some of the frames."""
        return AxisMotion(self.translation_px[which], self.axis, self.band_hz)


class Tracker(ABC):
    """Follows one target through frames; the translation counts from the reference frame.

    A new tracker is a class with `push` and, in `_state`, everything that changes from frame to frame: a frozen record
    with the translation `x_px`, `y_px`, whose type the class declares. A checkpoint needs `reference`, `region`, the
    settings and `state`: a tracker built anew from the first three gives the same values as the old one after
    `restore(state)`.
    """

    _state: Any = None
    # The core's tracker, where one call may take a frame through it and the rest of a target's chain, see `search`.
    core: Registration | None = None
    # Whether nothing more is to be learned from frames: many at once may go to the core then.
    settled = True

    def __init__(self, reference: Frame, region: Region) -> None:
        self._reference, self._region = reference, region

    @property
    def reference(self) -> Frame:
        """The frame that the translation counts from."""
        return self._reference

    @property
    def region(self) -> Region:
        """The target's region in the reference frame."""
        return self._region

    @property
    def region_now(self) -> Region:
        """Where the target was last seen or, when it is lost, is looked for; always inside the image."""
        rows, columns = self.reference.pixels.shape
        state = self.state
        return clamp(shift(self.region, state.x_px, state.y_px), columns, rows)

    @property
    def state(self) -> Any:
        """Everything that changes from frame to frame, as a frozen record."""
        return self._state

    def restore(self, state: Any) -> None:
        """Continue from a `state` taken earlier."""
        self._state = state

    @abstractmethod
    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px; x right, y down) in `frame`, looked for around `prediction` where there is one.

        Frames come in the order of their times. A target that cannot be found gives status LOST and NaN.
        Raises DataError when the frame's size is not the reference's.
        """

    def search(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """As `push`, of a frame that `core` has looked at, where there is one, and did not find the target for sure."""
        return self.push(frame, prediction)

    def keep(self, frame: Frame) -> None:  # noqa: B027 - most trackers do not learn on the way
        """Learn from a frame that `core` found the target in undisturbed."""

    @property
    def frames_to_learn(self) -> int:
        """How many frames are worth learning from before the first is tracked; 0: none."""
        return 0

    @property
    def learns_by_acceleration(self) -> bool:
        """Whether it is to be taught with the accelerometer's translation, and not without."""
        return False

    def learn(
        self,
        frames: Sequence[Frame],
        translation_px: Floats | None = None,
        *,
        direction: str = "y",
        band_hz: tuple[float, float] | None = None,
    ) -> Any:
        """Learn from frames, in the order of their times, that begin with the reference frame; the zero stays there.

        translation_px (n,): along the image axis `direction` as the accelerometer shows it, where it is known, to be
        compared within `band_hz` only. Trackers that learn from the picture alone leave all three aside. Returns what
        is now in use. Raises DataError where too few frames show the target.
        """
        axis = AXES.index(option("direction", direction, AXES))
        if translation_px is None:
            return self._learn(frames, None)
        if len(translation_px) != len(frames):
            raise refuse("translation_px", f"one value for each of the {len(frames)} frames", len(translation_px))
        return self._learn(frames, AxisMotion(np.asarray(translation_px, dtype=np.float64), axis, band_hz))

    def _learn(self, frames: Sequence[Frame], motion: AxisMotion | None) -> Any:
        """What `learn` does; motion: None where it is not known. Most trackers learn nothing."""
        return None

    @property
    def scale_share_std(self) -> float:
        """Standard deviation of the share by which all translations are too small or too large, as far as it knows."""
        return 0.0

    @property
    def phase_gain_px_per_rad(self) -> tuple[float, float] | None:
        """Translation by mean phase along x and y, px/rad, signed; None for trackers that measure no phase."""
        return None

    @property
    def active_pixels(self) -> "ActivePixels | None":
        """The pixels whose phase is measured; None for trackers that measure no phase."""
        return None


@dataclass(frozen=True, slots=True)
class TrackerEntry:
    """One row of the table: the module, its tracker and settings classes, and when to use it.

    printed: "module:name", in the room of the papers, of what opens the tracker where its settings say `as_printed`.
    """

    module: str
    tracker: str
    settings: str
    use: str
    printed: str = ""


TRACKERS: dict[str, TrackerEntry] = {
    "template": TrackerEntry(
        module="midspan.vision.template",
        tracker="TemplateTracker",
        settings="TemplateSettings",
        use="correlation with the first frame; for a textured target of constant appearance",
        printed="midspan.papers.printed.template:PrintedTemplateTracker",
    ),
    "features": TrackerEntry(
        module="midspan.vision.features",
        tracker="FeatureTracker",
        settings="FeatureSettings",
        use="matched features without mismatches; for partial occlusion or uneven light; slower, less accurate",
        printed="midspan.papers.printed.features:printed_features",
    ),
    "registration": TrackerEntry(
        module="midspan.vision.registration",
        tracker="RegistrationTracker",
        settings="RegistrationSettings",
        use="most accurate: near the Cramér-Rao bound; robust against shadows, occlusion, roll and zoom",
    ),
    "phase": TrackerEntry(
        module="midspan.vision.hybrid",
        tracker="PhaseTracker",
        settings="PhaseSettings",
        use="local phase without a search; for small motion or a good prediction",
        printed="midspan.papers.printed.phase:printed_phase",
    ),
    "hybrid": TrackerEntry(
        module="midspan.vision.hybrid",
        tracker="HybridTracker",
        settings="PhaseSettings",
        use="local phase after a search that prevents wrapping; for changing light and occlusion",
        printed="midspan.papers.printed.phase:printed_hybrid",
    ),
}

DEFAULT_TRACKER = "registration"
# The paper's rule for the reference frame: a module in the room of the papers with an `UpdatingTracker` and what makes
# its settings of a tracker's name, its settings and a table, `updating_settings`.
UPDATING = "midspan.papers.printed.updating"


def tracker_settings(name: str, **values: Any) -> Any:
    """The settings record of the tracker `name` with `values` in place of its defaults; UsageError if unknown."""
    entry = TRACKERS[option("tracker", name, TRACKERS)]
    made = getattr(importlib.import_module(entry.module), entry.settings)
    check_values(f"setting of the tracker {name!r}", values, made.__dataclass_fields__)
    return made(**values)


def check_values(what: str, values: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """UsageError unless each key is one of the fields `known` of a settings record, its value of that one's kind."""
    for key, value in values.items():
        option(what, key, known)
        _check_kind(key, value, known[key].default)


def _check_kind(key: str, value: Any, default: Any) -> None:
    """UsageError unless the value is of the default's kind: a number, a word, or true or false."""
    kinds: tuple[tuple[Any, Any, str], ...] = (
        (bool, bool, "true or false"),
        (str, str, "a text"),
        (int, int, "a whole number"),
        ((float, type(None)), (int, float), "a number"),
    )
    kind, allowed, words = next(row for row in kinds if isinstance(default, row[0]))
    if not isinstance(value, allowed) or (isinstance(value, bool) and kind is not bool):
        raise refuse(key, words, value)


def open_tracker(name: str, reference: Frame, region: Region | Sequence[int], settings: Any = None) -> Tracker:
    """A tracker for the target in `region` (x, y, width, height in px) of the frame `reference`.

    `name` is a key of TRACKERS; `settings` is that tracker's settings record, its defaults when left out.
    Raises UsageError for an unknown name, a region outside the image or without texture; DataError for a frame that is
    not one image plane of real numbers.
    """
    entry, region = TRACKERS[option("tracker", name, TRACKERS)], region_of(region)
    instance("reference", reference, Frame, "a Frame", "Frame(time_ns, pixels) makes one of an array.")
    if reference.pixels.ndim != 2:
        raise DataError(
            f"A frame must be one image plane (rows, columns); received an array of shape {reference.pixels.shape}. "
            "Give the luma plane."
        )
    if reference.pixels.dtype.kind not in "buif":
        raise DataError(f"A frame must hold real numbers; received an array of {reference.pixels.dtype}.")
    rows, columns = reference.pixels.shape
    check_region(region, columns, rows)
    known = getattr(importlib.import_module(entry.module), entry.settings)
    if settings is not None and not isinstance(settings, known):
        raise refuse("settings", f"a {entry.settings} for the tracker {name!r}", type(settings).__name__)
    opener = tracker_class(name)
    if getattr(settings, "as_printed", False):
        module, printed = entry.printed.split(":")
        opener = getattr(importlib.import_module(module), printed)
    tracker: Tracker = opener(reference, region, settings or known())
    return tracker


def tracker_class(name: str) -> Any:
    """The class of the tracker `name`, a key of TRACKERS."""
    return getattr(importlib.import_module(TRACKERS[name].module), TRACKERS[name].tracker)
