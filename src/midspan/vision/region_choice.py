"""The choice of targets where none is given: the picture proposes, the accelerometer decides.

The picture alone cannot tell a fixed wall from a tree that fills half of the image. So the best places are followed
through the first part of the calibration window, and what agrees with the accelerometer most sharply is taken.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import MidspanError
from midspan.progress import Progress
from midspan.records import NANOSECONDS, Frame, Nanoseconds, PixelTrack, PixelTranslation, Region
from midspan.vision.blocks import EVERY, Blocks
from midspan.vision.candidates import Candidate
from midspan.vision.roi import RegionChoice, RoiSettings, choose_region, further_places
from midspan.vision.template import TemplateSettings, TemplateTracker

# The picture's choice looks at this many frames, spread over this many seconds from the first frame used.
CHOICE_FRAMES = 16
CHOICE_S = 8.0
# The accelerometer's choice: this many frames over at least this many seconds, and no more seconds and frames than
# these.
TRIAL_FRAMES = 200
TRIAL_S = 20.0
MAX_TRIAL_S = 40.0
MAX_DECODED = 3000
# A place with this many times the best one's noise adds less than 1 % to what the best one knows.
USELESS = 10.0
# A frame in twenty missed doubles what a place costs: the band opens tenfold until the next one.
MISSED_WEIGHT = 20.0
NOTABLE_MISSED = 0.02
# This many places are tried, of which this many may be ones that most of the picture does not move with.
TRIAL_PLACES = 6
TRIAL_OUTSIDERS = 2
# Of places across an edge this many are moved.
MAX_ACROSS = 2
# While too few places are clean, other places are tried, this many times.
MORE_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Agreement:
    """What the accelerometer says of a place.

    std_m: noise of one frame's displacement, infinite where no scale factor could be found; contradicts: whether the
    place moves, but not with the accelerometer; text: in words; missed: share (0 to 1) of the frames without a value;
    scale_m_per_px: the scale factor, NaN where there is none.
    """

    std_m: float
    contradicts: bool
    text: str
    missed: float = 0.0
    scale_m_per_px: float = np.nan

    @property
    def cost_m(self) -> float:
        """What places are ranked by: the noise, raised where frames are missed, as by things that pass in front."""
        return self.std_m * (1.0 + MISSED_WEIGHT * self.missed)


Judge = Callable[[PixelTrack, bool], Agreement]
"""What the accelerometer says of a place's track; whether at a clock offset beyond the range, too."""
Reader = Callable[[int, int], Iterable[Frame]]
"""Gives the frames from one index up to another one, which is left out."""


@dataclass(frozen=True, slots=True)
class ChoiceRequest:
    """What is looked for: the measured image axis, how many targets, from which frame on; when the trial begins."""

    direction: str
    count: int
    first: int
    trial_from_ns: int | None = None


def choose_targets(
    read: Reader, time_ns: Nanoseconds, request: ChoiceRequest, progress: Progress, judge: Judge | None
) -> RegionChoice:
    """The regions to track, chosen from frames whose stamps from `request.first` on are `time_ns` (n,).

    read: gives the frames. judge: asks the accelerometer; left out, the picture alone decides.
    Raises DataError where no place can be followed.
    """
    until = time_ns[0] + int(CHOICE_S * NANOSECONDS)
    count = max(int(np.searchsorted(time_ns, until, side="right")), min(len(time_ns), CHOICE_FRAMES))
    wanted = np.unique(np.linspace(0, count - 1, CHOICE_FRAMES).astype(int))
    frames = list(_taken(read, request.first + wanted, progress, "choosing the region"))
    choice = choose_region(frames, RoiSettings(direction=request.direction, regions=request.count))
    places = trial_places(choice.candidates)
    if judge is None or len(places) < 2:
        return choice
    trial = _Trial(read, _trial_frames(time_ns, request), progress, judge, request.direction)
    found = trial.of([place.region for place in places])
    choice, found = _as_one(choice, found, trial)
    for _ in range(MORE_ROUNDS):
        fitting = _fitting(found)
        clean = [region for region in fitting if found[region].missed < NOTABLE_MISSED]
        if not fitting or len(clean) >= request.count:
            break
        # What the picture proposed was mostly leaves and the like; now it is known where they are.
        avoided = [c.region for c in choice.candidates if c.region not in clean]
        more = further_places(choice, clean, avoided, TRIAL_PLACES)
        tried = trial.of([region for region, _ in more])
        if not tried:
            break
        found |= tried
        nothing = PixelTrack.stack([])
        added = tuple(Candidate(region, std_px, nothing, np.nan) for region, std_px in more if region in tried)
        choice = replace(choice, candidates=(*choice.candidates, *added))
    return judged(choice, found, request.count) if found else choice


def _as_one(
    choice: RegionChoice, found: dict[Region, Agreement], trial: "_Trial"
) -> tuple[RegionChoice, dict[Region, Agreement]]:
    """The choice with places that move as one instead of those across the edge of what moves."""
    across = [region for region in found if trial.places[region] != (region,)]
    fitting = sorted((region for region in across if np.isfinite(found[region].std_m)), key=lambda r: found[r].cost_m)
    origin = {place: whole for whole in fitting[:MAX_ACROSS] for place in trial.places[whole]}
    tried = trial.of(list(origin)) if origin else {}
    # A place that is across an edge in its turn is no better.
    tried = {region: one for region, one in tried.items() if trial.places[region] == (region,)}
    if not any(np.isfinite(one.std_m) for region, one in (found | tried).items() if region not in across):
        return choice, found
    known, nothing = {one.region: one for one in choice.candidates}, PixelTrack.stack([])
    added = [Candidate(one, known[origin[one]].predicted_std_px, nothing, np.nan) for one in tried]
    text = "it lies across the edge of what moves"
    found = {r: replace(one, std_m=np.inf, text=text) if r in across else one for r, one in found.items()}
    return replace(choice, candidates=(*choice.candidates, *added)), found | tried


def trial_places(ranked: Sequence[Candidate]) -> list[Candidate]:
    """The places worth a trial: the best of those that move alike, and a few others, lest most of them be leaves."""
    fixed = [c for c in ranked if c.fixed]
    others = [c for c in ranked if not c.fixed and np.isfinite(c.disagreement_px)][:TRIAL_OUTSIDERS]
    return [*fixed[: TRIAL_PLACES - len(others)], *others]


def judged(choice: RegionChoice, found: dict[Region, Agreement], count: int) -> RegionChoice:
    """The choice after the accelerometer was heard.

    Places that fit it come first, by the noise of their displacement; where none fits (too little motion, say), the
    picture's order stands, without those that contradict the accelerometer.
    """
    fitting = _fitting(found)
    open_ones = [
        c.region for c in choice.candidates if c.fixed and not (c.region in found and found[c.region].contradicts)
    ]
    regions = tuple((fitting or open_ones or list(choice.regions))[:count])
    reported = [_reported(c, found.get(c.region), (regions, fitting)) for c in choice.candidates]
    order = {region: place for place, region in enumerate(regions)}
    reported.sort(key=lambda c: order.get(c.region, len(order)))
    reason = _reason(found, len(fitting), regions)
    return replace(
        choice,
        regions=regions,
        reasons=(reason, *(f"From the image alone: {line}" for line in choice.reasons)),
        candidates=tuple(reported),
    )


def _fitting(found: dict[Region, Agreement]) -> list[Region]:
    """The regions that fit the accelerometer, the best first; what fits ten times worse, half leaves say, does not."""
    best = min((agreement.std_m for agreement in found.values()), default=np.inf)
    fitting = [r for r, agreement in found.items() if np.isfinite(best) and agreement.std_m <= USELESS * best]
    return sorted(fitting, key=lambda region: found[region].cost_m)


def _reason(found: dict[Region, Agreement], fitting: int, regions: tuple[Region, ...]) -> str:
    start = f"{len(found)} places were tracked and compared with the accelerometer"
    if not fitting:
        text = next(iter(found.values())).text
        return f"{start}, which could not decide between them ({text}); the image alone decided."
    were = "ones with the least noise in mm were" if len(regions) > 1 else "one with the least noise in mm was"
    return (
        f"{start}; {fitting} of them fit it, and the {were} selected ({1e3 * found[regions[0]].std_m:.2g} mm a frame)."
    )


def _reported(
    candidate: Candidate, agreement: Agreement | None, chosen: tuple[tuple[Region, ...], list[Region]]
) -> Candidate:
    """The candidate with its verdict; chosen: the regions taken, and those that fit."""
    if agreement is None:
        return candidate
    taken, fitting = chosen
    verdict = f"taken: {agreement.text}" if candidate.region in taken else agreement.text
    if candidate.region not in fitting:
        poor = np.isfinite(agreement.std_m)
        return replace(candidate, verdict=f"moves on its own: {verdict}" if poor else verdict)
    found = replace(candidate, verdict=verdict, displacement_std_m=agreement.std_m)
    return replace(found, scale_m_per_px=agreement.scale_m_per_px)


@dataclass(slots=True)
class _Trial:
    """Places followed through chosen frames, and judged.

    near: whether one of them fits within the range of clock offsets. Nothing is looked for beyond it then: leaves may
    happen to fit there. places: as of `Blocks.places`.
    """

    read: Reader
    wanted: NDArray[np.int64]
    progress: Progress
    judge: Judge
    axis: str
    near: bool = field(default=False, init=False)
    places: dict[Region, tuple[Region, ...]] = field(default_factory=dict, init=False)

    def of(self, regions: Sequence[Region]) -> dict[Region, Agreement]:
        """What the accelerometer says of each region; those without a template there are left out."""
        trackers: list[TemplateTracker | None] = []
        rows: list[list[PixelTranslation]] = [[] for _ in regions]
        blocks = [Blocks(region, self.axis) for region in regions]
        # One frame after the other: hundreds of large ones would not fit into memory.
        frames = _taken(self.read, self.wanted, self.progress, "trying the region's candidates") if regions else ()
        for number, frame in enumerate(frames):
            trackers = trackers or [_opened(frame, region) for region in regions]
            for tracker, found in zip(trackers, rows, strict=True):
                if tracker is not None:
                    found.append(tracker.push(frame))
            for one in blocks if number % EVERY == 0 else ():
                one.push(frame)
        self.places |= {one.region: one.places() for one in blocks}
        tracks = {r: PixelTrack.stack(found) for r, found in zip(regions, rows, strict=True) if found}
        judged = {region: self.judge(track, False) for region, track in tracks.items()}
        self.near = self.near or any(np.isfinite(one.std_m) for one in judged.values())
        if self.near:
            return judged
        # What is static contradicts nothing, at any offset.
        again = {region: self.judge(tracks[region], True) for region, one in judged.items() if one.contradicts}
        return judged | again


def _trial_frames(time_ns: Nanoseconds, request: ChoiceRequest) -> NDArray[np.int64]:
    """Indices of the frames of a trial: up to 200, over 20 s or more where there are this many."""
    start = 0 if request.trial_from_ns is None else int(np.searchsorted(time_ns, request.trial_from_ns))
    start = min(start, max(len(time_ns) - TRIAL_FRAMES, 0))
    inside = time_ns[start:]
    usual = int(np.searchsorted(inside, inside[0] + int(TRIAL_S * NANOSECONDS)))
    longest = int(np.searchsorted(inside, inside[0] + int(MAX_TRIAL_S * NANOSECONDS)))
    step = max(1, -(-usual // TRIAL_FRAMES))
    return request.first + start + np.arange(0, min(TRIAL_FRAMES * step, longest, MAX_DECODED, len(inside)), step)


def _opened(frame: Frame, region: Region) -> TemplateTracker | None:
    try:
        return TemplateTracker(frame, region, TemplateSettings())
    except MidspanError:
        return None


def _taken(read: Reader, wanted: NDArray[np.int64], progress: Progress, what: str) -> Iterator[Frame]:
    """The frames of these indices (m,), in their order."""
    chosen, first, last = set(wanted.tolist()), int(wanted[0]), int(wanted[-1]) + 1
    for frame in read(first, last):
        progress(frame.index - first, last - first, what)
        if frame.index in chosen:
            yield frame
