"""The frames of a radar in the calibration window, the acceleration at that time, and the targets in its clear part."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.lines import Shown
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.radar.blockage import MAX_SHARE, MIN_SHARE
from midspan.radar.channels import noise_variance
from midspan.radar.chirp import RadarInfo
from midspan.radar.following import at_place, peaks
from midspan.radar.frames import RadarFrames, samples_of, together, without_holes
from midspan.radar.target import Target, find_targets
from midspan.records import NANOSECONDS, Floats
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.health import runs

# Fewer frames determine no conversion factor.
MIN_FRAMES = 100
# Where acceleration is missing for longer than this, s, the longest part without it is used if it is this share of the
# window at least: a double integral over a guess fits no phase.
MIN_GAP_S, MIN_UNBROKEN = 0.05, 0.25
# Where targets are hidden in the window for this many frames on end, its longest clear part is used if it is this share
# of it at least; above the other share nothing needs to be left out.
MIN_FLAW_FRAMES, MIN_CLEAR, ALL_CLEAR = 20, 0.25, 0.99
# Where no target follows the accelerometer, a clock offset is looked for up to this share of the window.
FAR_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class OpenedWindow:
    """The frames of the calibration window, their stamps from its first one on, and their `samples_of`.

    reported: sentences; clock: stamp of the first frame, ns, and the largest clock offset, s.
    """

    frames: RadarFrames
    samples: Floats
    reported: list[Notice]
    clock: tuple[int, float]


def opened(
    frames: RadarFrames,
    prepared: PreparedAcceleration,
    ends: tuple[int, int],
    max_offset_s: float,
    reported: list[Notice],
) -> OpenedWindow:
    """The frames of a window, and the acceleration with a margin for the clock offset, without long gaps.

    ends: first and last stamp (ns) of the window's acceleration; reported: what there is to report of the frames.
    """
    origin = int(frames.time_ns[0])
    frames = replace(frames, time_ns=frames.time_ns - origin)
    max_offset = min(max_offset_s, 0.1 * float(frames.time_ns[-1]) / NANOSECONDS)
    margin = round((max_offset + 1.0) * NANOSECONDS)
    if (kept := _unbroken(prepared, frames, (origin, max_offset))) is not None:
        begin, frames = int(frames.time_ns[kept][0]), _part(frames, kept)
        frames = replace(frames, time_ns=frames.time_ns - begin)
        origin, last = origin + begin, int(frames.time_ns[-1])
        text = (
            "radar: the accelerometer has gaps in the calibration window; the longest part without a gap, "
            f"{last / NANOSECONDS:.3g} s, was used."
        )
        reported = [*reported, Notice("window-moved", text)]
        ends, margin = (origin, origin + last), round(max_offset * NANOSECONDS)
    samples = samples_of(prepared, origin, (ends[0] - margin, ends[1] + margin))
    return OpenedWindow(frames, samples, reported, (origin, max_offset))


def _part(frames: RadarFrames, part: slice) -> RadarFrames:
    return RadarFrames(frames.time_ns[part], frames.phasors[part], frames.valid[part])


def _unbroken(prepared: PreparedAcceleration, frames: RadarFrames, known: tuple[int, float]) -> slice | None:
    """The longest segment of frames in which no acceleration is missing at any clock offset that is tried."""
    margin = round(known[1] * NANOSECONDS)
    gaps = prepared.unmeasured_ns - known[0]
    gaps = gaps[(gaps[:, 1] - gaps[:, 0]) > MIN_GAP_S * NANOSECONDS] + np.array([-margin, margin])
    within = gaps[(gaps[:, 1] > frames.time_ns[0]) & (gaps[:, 0] < frames.time_ns[-1])]
    if not len(within):
        return None
    starts = np.concatenate(([0], np.searchsorted(frames.time_ns, within[:, 1])))
    ends = np.concatenate((np.searchsorted(frames.time_ns, within[:, 0]), [len(frames.time_ns)]))
    k = int(np.argmax(ends - starts))
    enough = ends[k] - starts[k] >= max(MIN_FRAMES, MIN_UNBROKEN * len(frames.time_ns))
    return slice(int(starts[k]), int(ends[k])) if enough else None


def clearly_seen(
    frames: RadarFrames, samples: Floats, info: RadarInfo, given: tuple[float, int]
) -> tuple[tuple[Target, ...], RadarFrames, list[Notice]]:
    """The targets, the frames of the window in which the best ones were not hidden, and a sentence on those left out.

    given: largest clock offset (s) and how many targets are used. What stands before a target would be taken for its
    noise.
    """
    found = found_targets(frames, samples, info, given[0])
    best = [target for target in found if not target.objection]
    best = sorted(best, key=lambda target: target.noise_m)[: given[1]]
    if not best:
        return _in_a_half(found, frames, samples, (info, given[0]))
    longest = _longest_clear(frames, best)
    if longest.stop - longest.start < MIN_CLEAR * len(frames.time_ns):
        # What stands before one target may be taken for another, seen for a short time only.
        longest = max((_longest_clear(frames, [target]) for target in best), key=lambda part: part.stop - part.start)
    count = longest.stop - longest.start
    if count >= ALL_CLEAR * len(frames.time_ns) or count < max(MIN_FRAMES, MIN_CLEAR * len(frames.time_ns)):
        return found, frames, []
    frames = _part(frames, longest)
    length_s = float(frames.time_ns[-1] - frames.time_ns[0]) / NANOSECONDS
    text = (
        f"radar: a target was occluded in the calibration window; the longest unobstructed part, {length_s:.3g} s, "
        "was used."
    )
    return found_targets(frames, samples, info, given[0]), frames, [Notice("window-moved", text)]


def _in_a_half(
    found: tuple[Target, ...], frames: RadarFrames, samples: Floats, given: tuple[RadarInfo, float]
) -> tuple[tuple[Target, ...], RadarFrames, list[Notice]]:
    """The targets in the half of the window that shows one better, where the whole shows none that can be used."""
    middle = len(frames.time_ns) // 2
    least, kept, text = np.inf, (found, frames), list[Notice]()
    for word, half in (("first", slice(0, middle)), ("second", slice(middle, None))):
        part = _part(frames, half)
        if len(part.time_ns) < MIN_FRAMES:
            continue
        seen = found_targets(part, samples, *given)
        std = min((target.relative_std for target in seen if not target.objection), default=np.inf)
        if std < least:
            least, kept = std, (seen, part)
            line = (
                f"radar: only the {word} half of the calibration window shows an undisturbed fixed target; it was used."
            )
            text = [Notice("window-moved", line)]
    return *kept, text


def found_targets(frames: RadarFrames, samples: Floats, info: RadarInfo, max_offset_s: float) -> tuple[Target, ...]:
    """All targets of the frames, relative to the accelerometer."""
    whole = without_holes(frames)
    time_s = whole.time_ns / NANOSECONDS
    return find_targets(
        whole.phasors, time_s, samples=samples, axis=info.axis, max_offset_s=max_offset_s, valid=whole.valid
    )


def shown_by_strongest(window: OpenedWindow, info: RadarInfo, range_m: float | None) -> Shown:
    """Second differences from frame to frame of the range, m, at the strongest peak or the one nearest to `range_m`.

    They need no unwrapping, for which the acceleration would have to be right.
    """
    frames = window.frames
    if (place := strongest_place(frames, info, range_m)) is None:
        return Shown(np.empty(0), np.empty(0))
    z = np.where(frames.valid, at_place(frames.phasors, place), np.nan)
    turned = np.nansum(z[1:] * np.conj(z[:-1]), axis=1)
    second = np.angle(turned[1:] * np.conj(turned[:-1])) / info.axis.phase_per_m(info.axis.range_at(place))
    steps_s = np.diff(frames.time_ns) / NANOSECONDS
    lag_s = float(np.median(steps_s))
    even = np.maximum(np.abs(steps_s[1:] - lag_s), np.abs(steps_s[:-1] - lag_s)) < 0.5 * lag_s
    known = even & (np.abs(turned[1:]) > 0.0) & (np.abs(turned[:-1]) > 0.0)
    return Shown(frames.time_ns[1:-1] / NANOSECONDS, np.where(known, second, np.nan), lag_s)


def strongest_place(frames: RadarFrames, info: RadarInfo, range_m: float | None) -> float | None:
    """Fractional bin of the strongest peak, or of the one nearest to `range_m`; None where there is none."""
    bins = peaks(frames.phasors, noise_variance(frames.phasors))
    if not bins:
        return None
    ranges_m = np.array([info.axis.range_at(place) for place in bins])
    if range_m is not None and np.isfinite(ranges_m).all():
        return bins[int(np.argmin(np.abs(ranges_m - range_m)))]
    return max(bins, key=lambda place: float(np.mean(np.abs(at_place(frames.phasors, place)) ** 2)))


def _longest_clear(frames: RadarFrames, targets: Sequence[Target]) -> slice:
    clear = np.ones(len(frames.time_ns), dtype=np.bool_)
    for target in targets:
        z = together(at_place(frames.phasors, target.place_bin)[..., None], target, frames.valid)[:, 0] - target.leak
        share = np.abs(z) / target.amplitude
        # A target that moves through its bin fades on its own.
        low = MIN_SHARE if target.reach_bins == 0.0 else 0.0
        clear &= ~((share < low) | (share > MAX_SHARE))
    flaws = [run for run in runs(~clear) if run[1] - run[0] >= MIN_FLAW_FRAMES]
    edges = [0, *(int(k) for run in flaws for k in run), len(clear)]
    starts, ends = edges[0::2], edges[1::2]
    k = int(np.argmax(np.subtract(ends, starts)))
    return slice(starts[k], ends[k])


def refuse_farther(
    frames: RadarFrames, prepared: PreparedAcceleration, info: RadarInfo, clock: tuple[int, float]
) -> None:
    """UntrustedError where a target follows the accelerometer at a clock offset beyond the largest.

    clock: what the frames' stamps count from, ns, and the largest clock offset, s.
    """
    origin, max_offset = clock
    length_s = float(frames.time_ns[-1] - frames.time_ns[0]) / NANOSECONDS
    far_ns = round(FAR_SHARE * length_s * NANOSECONDS)
    ends = origin + int(frames.time_ns[0]) - far_ns, origin + int(frames.time_ns[-1]) + far_ns
    samples = samples_of(prepared, origin, ends)
    # Frames beyond the acceleration spoil the coherence: with the offset that fits best they are left out.
    crude = [one for one in found_targets(frames, samples, info, FAR_SHARE * length_s) if one.coherence > 0.0]
    offset_s = max(crude, key=lambda one: one.coherence).time_offset_s if crude else 0.0
    if abs(offset_s) <= max_offset:
        return
    time_s = frames.time_ns / NANOSECONDS + offset_s
    met = np.flatnonzero((time_s > samples[0, 0] + max_offset) & (time_s < samples[-1, 0] - max_offset))
    if len(met) < MIN_FRAMES:
        return
    found = found_targets(
        _part(frames, slice(met[0], met[-1] + 1)), samples - np.array([offset_s, 0.0]), info, max_offset
    )
    usable = [target for target in found if not target.objection]
    if not usable:
        return
    offset_s += max(usable, key=lambda target: target.coherence).time_offset_s
    raise UntrustedError(
        f"radar: its clock seems to differ from the accelerometer's by {offset_s:+.4g} s (target {usable[0].place}), "
        f"but only ±{max_offset:.3g} s were searched. Add the difference to radar.start_s or to the frames' time "
        "stamps, or raise calibration.max_offset_s and use a window ten times as long."
    )
