"""The fixed targets of a calibration window, in its clear part, or the clock offset at which there would be some."""

from collections.abc import Sequence

import numpy as np

from midspan.calibration.radar.window import MIN_FRAMES
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.radar.blockage import MAX_SHARE, MIN_SHARE
from midspan.radar.chirp import RadarInfo
from midspan.radar.frames import RadarFrames, samples_of, together, without_holes
from midspan.radar.target import Target, at_place, find_targets
from midspan.records import NANOSECONDS, Floats
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.health import runs

# Where targets are hidden in the window for this many frames on end, its longest clear part is used if it is this share
# of it at least; above the other share nothing needs to be left out.
MIN_FLAW_FRAMES, MIN_CLEAR, ALL_CLEAR = 20, 0.25, 0.99
# Where no target follows the accelerometer, a clock offset is looked for up to this share of the window.
FAR_SHARE = 0.5


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
        f"radar: something hid a target in the calibration window; its longest clear part, {length_s:.3g} s, was used."
    )
    return found_targets(frames, samples, info, given[0]), frames, [Notice("window-moved", text)]


def _in_a_half(
    found: tuple[Target, ...], frames: RadarFrames, samples: Floats, given: tuple[RadarInfo, float]
) -> tuple[tuple[Target, ...], RadarFrames, list[Notice]]:
    """The targets in the half of the window that shows one better, where the whole shows none that can be used.

    What passes through a target's bin spoils all of the window, but seldom lasts for more than half of it.
    """
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
                f"radar: only the {word} half of the calibration window shows a fixed target undisturbed; it was used."
            )
            text = [Notice("window-moved", line)]
    return *kept, text


def _part(frames: RadarFrames, part: slice) -> RadarFrames:
    return RadarFrames(frames.time_ns[part], frames.phasors[part], frames.valid[part])


def found_targets(frames: RadarFrames, samples: Floats, info: RadarInfo, max_offset_s: float) -> tuple[Target, ...]:
    """All targets of the frames, relative to the accelerometer."""
    whole = without_holes(frames)
    time_s = whole.time_ns / NANOSECONDS
    return find_targets(
        whole.phasors, time_s, samples=samples, axis=info.axis, max_offset_s=max_offset_s, valid=whole.valid
    )


def _longest_clear(frames: RadarFrames, targets: Sequence[Target]) -> slice:
    """The longest segment of frames in which all targets had about their usual amplitude, short flaws allowed."""
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
        f"radar: its clock seems to differ from the accelerometer's by {offset_s:+.4g} s, where the target at "
        f"{usable[0].range_m:.2f} m follows it, but only ±{max_offset:.3g} s were searched. Add it to radar.start_s or "
        "to the frames' times, or raise calibration.max_offset_s, with a window of ten times that."
    )
