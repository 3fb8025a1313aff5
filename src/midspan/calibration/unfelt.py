"""Whether the accelerometer felt a displacement: a sensor that jumps makes decimetres where it shows millimetres.

What an accelerometer errs by (noise, drift, cross motion, tilt) is in its signal, in addition to the motion. So the
displacement differs from the acceleration integrated twice by no more than that itself shows there, or usually where it
has lost something: a cable breaks, or an error happens to cancel the motion. One that differs by more would need an
acceleration that the accelerometer would have shown.
"""

from collections.abc import Sequence

import numpy as np

from midspan.errors import UntrustedError
from midspan.fusion.blocks import REJECTED
from midspan.records import NANOSECONDS, Estimate, Event, Floats, Innovation, Nanoseconds, Status, part, seconds
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.integrate import path
from midspan.signals.stamps import shown

# Both are compared over windows of these lengths, s, or of twice as many values as there are unknowns where these take
# longer. Over the short ones a start, its velocity, a bias and its drift are open (a cubic). What runs away by a cycle
# a frame is a straight line there, whose speed changes from window to window: over 20 s and over the whole record the
# bias is held (a parabola). An accelerometer that drifts shows that much more.
LOOKS = ((5.0, 4), (20.0, 3), (np.inf, 3))
# Of white noise of density S, integrated twice over T, S T³ over this is left about this many unknowns (mean square).
NOISE_LEFT = {3: 2520.0, 4: 6930.0}
# Over the whole record this many values are enough.
MAX_COMPARED = 20_000
# Windows of this many values together are worked on at once, for memory.
AT_ONCE = 100_000
# A clean record is refused with this probability: the power of a narrow band in a window is exponentially distributed,
# so that of n windows one exceeds the mean ln(n / p) times with a probability p.
CHANCE = 1e-6
# The least share of rows that a radar's measurements support: more than half of a result is measured, not predicted.
# The largest share of them whose band may be wider than the motion: the radar is hidden for a while.
MIN_SUPPORTED, MAX_WIDE = 0.5, 0.1
# A step of the clock this near to frames without the target, ns, may be a lost cycle: several times as long as the
# segments over which steps are looked for.
NEAR_NS = NANOSECONDS

# What separates a radar's target from interference.
ALL_BINS = "The bins of all ranges (16 or more) separate interference from the target: store them."


def refuse_unfelt(prepared: PreparedAcceleration, time_ns: Nanoseconds, moved_m: Floats, variance_m2: Floats) -> None:
    """UntrustedError where a displacement (n,) differs from the acceleration by far more than that shows.

    time_ns (n,): on the accelerometer's clock, within the acceleration; variance_m2 (n,): of the displacement.
    """
    for length_s, unknowns in LOOKS:
        if not np.isfinite(length_s):
            some = slice(None, None, 1 + len(time_ns) // MAX_COMPARED)
            time_ns, moved_m, variance_m2 = time_ns[some], moved_m[some], variance_m2[some]
        windows = _windows(time_ns, length_s, unknowns)
        if windows:
            _refuse_windows(prepared, (time_ns, moved_m, variance_m2), windows, unknowns)


def _windows(time_ns: Nanoseconds, length_s: float, unknowns: int) -> list[slice]:
    """Windows of values (n,) that overlap by half, of a length or of twice as many values as there are unknowns."""
    step_s = float(np.median(np.diff(time_ns))) / NANOSECONDS if len(time_ns) > 1 else np.inf
    count = max(int(length_s / step_s), 2 * unknowns) if np.isfinite(length_s) else len(time_ns)
    if count < 2 * unknowns:
        return []
    return [slice(int(a), int(a) + count) for a in np.arange(0, len(time_ns) - count + 1, max(count // 2, 1))]


def _refuse_windows(
    prepared: PreparedAcceleration, moved: tuple[Nanoseconds, Floats, Floats], windows: list[slice], unknowns: int
) -> None:
    time_ns, moved_m, variance_m2 = moved
    felt, differs, missed = _powers(prepared, time_ns, moved_m, windows, unknowns)
    uncertain = np.array([np.mean(variance_m2[one]) for one in windows])
    allowed = felt + np.log(len(windows) / CHANCE) * (np.mean(felt) + missed + uncertain)
    k = int(np.argmax(differs / allowed))
    if differs[k] > allowed[k]:
        first, last = (int(time_ns[one]) for one in (windows[k].start, windows[k].stop - 1))
        raise UntrustedError(
            f"From {shown(first)} to {shown(last)} the displacement moves by {1e3 * np.sqrt(differs[k]):.3g} mm rms "
            f"that the accelerometer would have shown: it shows {1e3 * np.sqrt(felt[k]):.2g} mm there. "
            "The sensor or its clock jumps: leave these values out of the file. Or the accelerometer does not measure "
            "slow motion: use one that measures down to 0 Hz.",
            more=f"It shows {1e3 * np.sqrt(np.mean(felt)):.2g} mm on the whole. A GNSS receiver jumps between fixed "
            "and float solutions, a radar under interference. Piezoelectric sensors and a logger's high-pass leave "
            "slow motion out; warm-up adds some.",
        )


def measured_rows(rows: Estimate, innovation: Innovation) -> Estimate:
    """Rows that follow an accepted measurement: there a band that was opened for a jump is closed again."""
    met_ns = innovation.time_ns[innovation.verdict != REJECTED]
    place = np.unique(np.searchsorted(rows.time_ns, met_ns))
    return part(rows, place[place < len(rows.time_ns)])


def refuse_steps_unseen(steps_ns: Sequence[int], unseen_ns: Nanoseconds, sensor: str) -> None:
    """UntrustedError where a radar's clock seems to step (k instants) while its target is not seen.

    unseen_ns (n,): frames without a phase. A lost cycle and a clock that steps look the same there.
    """
    for step_ns in steps_ns:
        if np.any(np.abs(unseen_ns - step_ns) < NEAR_NS):
            raise UntrustedError(
                f"{sensor}: its clock seems to step at {shown(step_ns)}, but its target is not visible in frames "
                f"within {NEAR_NS / NANOSECONDS:g} s of that: a lost cycle, interference or another reflector in the "
                "bin looks the same. Give a time stamp for each frame, or leave frames with interference out.",
                more=ALL_BINS,
            )


def refuse_contradicted(events: Sequence[Event], targets: int, sensor: str) -> None:
    """UntrustedError where the accelerometer contradicts the phase of all of a radar's targets: one of both is wrong,
    nothing tells which, and cycles are lost unseen.

    events: of the radar; targets: how many are used.
    """
    found = [event for event in events if event.kind == "contradiction"]
    if found and len({event.text for event in found}) >= targets:
        raise UntrustedError(
            f"{sensor}: at {shown(found[0].time_ns)} its phase and the acceleration contradict each other, and no "
            "other target shows which is right. Cut the recording there and calibrate (calibration.window_s) on a "
            "part without it; give each frame a time stamp, or use a second target.",
            more="Its clock steps, frames are lost, the target moves on its own, or the accelerometer was knocked.",
        )


def refuse_lost_cycles(
    prepared: PreparedAcceleration, rows: Estimate, unseen_ns: Nanoseconds, density: float, relative_std: float
) -> None:
    """UntrustedError where a radar's displacement goes on otherwise than the accelerometer measures.

    A cycle is lost where the target was not seen, or something else was taken for it. There the displacement is
    compared with the noise that the accelerometer has, and not with all that it shows.
    rows: as judged, those that follow a measurement; unseen_ns (k,): frames without a phase; density: of the
    accelerometer's noise, (m/s²)²/Hz; relative_std: of the conversion factor.
    """
    length_s, unknowns = LOOKS[0]
    length_ns, last = round(length_s * NANOSECONDS), len(rows.time_ns) - 1
    middles: list[int] = []
    for one_ns in unseen_ns.tolist():
        if not middles or one_ns - middles[-1] >= length_ns // 2:
            middles.append(one_ns)
    ends = [(one_ns - length_ns // 2, one_ns + length_ns // 2) for one_ns in middles]
    places = [slice(*np.searchsorted(rows.time_ns, pair)) for pair in ends]
    windows = [one for one in places if one.stop - one.start >= 2 * unknowns and one.stop <= last]
    if not windows:
        return
    chance = np.log(len(windows) / CHANCE)
    powers = _powers(prepared, rows.time_ns, rows.displacement_m, windows, unknowns)
    for one, (felt, differs, missed) in zip(windows, powers.T, strict=True):
        time_ns, variance = rows.time_ns[one], rows.variance_m2[one]
        noise = density * ((int(time_ns[-1]) - int(time_ns[0])) / NANOSECONDS) ** 3 / NOISE_LEFT[unknowns]
        # What the rows have in common is no motion.
        uncertain = float(np.mean(variance) - np.min(variance))
        if differs > chance * (noise + relative_std**2 * felt + missed + uncertain):
            raise UntrustedError(
                f"From {shown(int(time_ns[0]))} to {shown(int(time_ns[-1]))} the radar loses its target, and the "
                f"displacement differs from the acceleration by {1e3 * np.sqrt(differs):.3g} mm rms (accelerometer "
                f"noise: {1e3 * np.sqrt(noise):.2g} mm). A cycle was lost, or interference or a moving object was "
                "taken for the target: leave these frames out of the file.",
                more=ALL_BINS,
            )


def refuse_wide(prepared: PreparedAcceleration, rows: Estimate) -> None:
    """UntrustedError where half of a radar's rows rest on no measurement of it, or many are known worse than all motion
    that the accelerometer shows.
    """
    supported = float(np.mean(rows.status == Status.TRACKING))
    if supported < MIN_SUPPORTED:
        raise UntrustedError(
            f"Only {100 * supported:.0f} % of the rows have a measurement; at least {100 * MIN_SUPPORTED:.0f} % are "
            "needed: the radar's target is occluded or masked by another reflector in its bin, and the accelerometer "
            "alone drifts. Aim the radar at an unobstructed target, or cut the recording where it is lost."
        )
    wide, (length_s, unknowns) = float(np.quantile(rows.variance_m2, 1.0 - MAX_WIDE)), LOOKS[1]
    windows = _windows(rows.time_ns, length_s, unknowns)
    if not windows:
        return
    felt, _, missed = np.mean(_powers(prepared, rows.time_ns, rows.displacement_m, windows, unknowns), axis=1)
    if wide > np.log(1.0 / CHANCE) * (felt + missed):
        raise UntrustedError(
            f"In {100 * MAX_WIDE:.0f} % of the rows σ is {1e3 * np.sqrt(wide):.3g} mm or more, but the accelerometer "
            f"shows only {1e3 * np.sqrt(felt):.2g} mm rms in {length_s:g} s: the radar loses its target too often. "
            "Leave frames with interference out of the file, or aim the radar at an unobstructed target."
        )


def _powers(
    prepared: PreparedAcceleration, time_ns: Nanoseconds, moved_m: Floats, windows: Sequence[slice], unknowns: int
) -> Floats:
    """Mean squares (3, windows), m², about polynomials of this many unknowns: of the acceleration integrated twice, of
    what a displacement (n,) differs from it by, and of what acceleration that is missing leaves open.
    """
    first, last = np.searchsorted(prepared.time_ns, (time_ns[0], time_ns[-1]))
    near = slice(max(int(first) - 1, 0), int(last) + 1)
    origin = int(time_ns[0])
    time_s, sampled_s = seconds(time_ns, origin), seconds(prepared.time_ns[near], origin)
    # Start, speed and a constant are open in every window: one integral does for all.
    felt_m = path(time_s, sampled_s, prepared.value_m_s2[near])
    both = np.column_stack((felt_m, moved_m - felt_m))
    lengths, starts = np.array([one.stop - one.start for one in windows]), np.array([one.start for one in windows])
    left = np.empty((2, len(windows)))
    for length in np.unique(lengths):
        alike = np.flatnonzero(lengths == length)
        for some in np.array_split(alike, -(-len(alike) * int(length) // AT_ONCE)):
            index = starts[some, None] + np.arange(length)
            left[:, some] = _left(time_s[index], both[index], unknowns)
    length_s = time_s[starts + lengths - 1] - time_s[starts]
    edges = np.searchsorted(sampled_s, np.stack((time_s[starts], time_s[starts + lengths - 1])))
    edges += np.array([[-1], [1]])
    summed = np.concatenate(([0.0], np.cumsum(prepared.bridging_density[near])))
    begin, end = np.clip(edges, 0, len(sampled_s))
    missed = (summed[end] - summed[begin]) / (end - begin) * length_s**3 / NOISE_LEFT[unknowns]
    return np.vstack((left, missed))


def _left(time_s: Floats, both: Floats, unknowns: int) -> Floats:
    """Mean squares (2, w) of two columns (w, n, 2) at times (w, n) about a polynomial in each of w windows."""
    since_s = time_s - time_s[:, :1]
    u = since_s / since_s[:, -1:]
    basis = np.linalg.qr(u[:, :, None] ** np.arange(unknowns))[0]
    left = both - basis @ (basis.transpose(0, 2, 1) @ both)
    return np.asarray(np.mean(left**2, axis=1).T)
