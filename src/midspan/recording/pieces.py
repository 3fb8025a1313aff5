"""A long recording in overlapping pieces of time, smoothed one by one: their rows, joined, are those of the whole.

A filter and a smoother forget: rows far from a piece's ends follow from what the piece holds. What is decided once for
a recording (calibration, how the clocks ran) is decided by the whole. Whatever a piece cannot know, as a zero that
stepped before it, leaves a difference where two pieces overlap (`agree`): the recording is then to be estimated whole.

Tables are cut, the accelerometer's with those of displacement sensors. A camera's tracker, a radar's chain and what
helps them remember all that they saw: these recordings stay whole.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from midspan.calibration.displacement.sensor import read_with
from midspan.engine.second_look import ran_apart
from midspan.progress import silent
from midspan.recording.calibrate import calibrate
from midspan.recording.estimate import Asked, FirstPass, check, clocks_of, first_pass, result_of, smoothed, wrong_of
from midspan.recording.kinds import ROWS
from midspan.recording.result import Result
from midspan.recording.run import Outcome
from midspan.recording.streams.recording import Recording, naming
from midspan.recording.tracked import known_sensors
from midspan.records import NANOSECONDS, Estimate, Nanoseconds, Readings, TimeSeries, part
from midspan.settings.kinds import KINDS
from midspan.settings.stored.calibration import Calibration

# A piece has about this many samples, and lasts this long at least, s: what is run twice is little of it.
PIECE_SAMPLES, PIECE_S = 1_000_000, 10_000.0
# A piece begins so much before its own rows and ends so much after them, s. Measured with a GNSS: after 20 s rows
# differ by 0.4 % of their standard deviation, and no less after longer, standard deviations after 120 s by 0.03 %.
OVERLAP_S = 300.0
# Around the instant where two pieces meet, rows of both are compared over so much on both sides, s.
SEAM_S = 10.0
# Rows of two pieces agree where displacements differ by this share of their standard deviation, or by this many metres,
# and standard deviations by this share. What is left is the accelerometer's gain, which a shorter record determines
# less well: 1.3 % where pieces last an hour and a half, 0.5 % where they last three. Rows of six hours then differ
# from the whole's by 1.3 % in a minute without a measurement, elsewhere by 1.1 %.
MAX_SHARE, MAX_DIFFERENCE_M = 0.01, 1e-7


@dataclass(frozen=True, slots=True)
class Span:
    """The rows of a piece: from `first_ns` on and before `end_ns`, on the accelerometer's clock."""

    first_ns: int
    end_ns: int

    def wider(self, by_s: float) -> "Span":
        """The same with so much on both sides."""
        return Span(self.first_ns - round(NANOSECONDS * by_s), self.end_ns + round(NANOSECONDS * by_s))

    def holds(self, time_ns: Nanoseconds) -> slice:
        """Where it is in increasing stamps (n,)."""
        first, end = np.searchsorted(time_ns, (self.first_ns, self.end_ns))
        return slice(int(first), int(end))


def may_be_cut(recording: Recording, method: str | None) -> bool:
    """Whether a recording is of tables alone, is long and is to be smoothed."""
    settings = recording.settings
    if settings.accelerometer is None or (method or settings.fusion.method) != "smoother" or settings.fusion.literal:
        return False
    if settings.auxiliary or settings.accelerometer.cross_values or not recording.sensors:
        return False
    return all(KINDS[one.kind].brings is Readings for one in recording.sensors) and len(spans_of(recording)) > 1


def spans_of(recording: Recording) -> tuple[Span, ...]:
    """The pieces' own spans, of equal length; a single one for a short recording."""
    time_ns = recording.acceleration.time_ns
    length_ns = int(time_ns[-1] - time_ns[0])
    count = max(1, min(len(time_ns) // PIECE_SAMPLES, int(length_ns // (NANOSECONDS * PIECE_S))))
    edges = [int(time_ns[0]) + k * length_ns // count for k in range(count)]
    return tuple(Span(*ends) for ends in pairwise([*edges, int(time_ns[-1]) + 1]))


def calibrated(recording: Recording) -> tuple[Calibration, tuple[Span, ...]]:
    """The calibration of a recording, and its pieces; none where it has to be estimated whole."""
    calibration = calibrate(recording)
    with naming(recording):
        plain = not calibration.lines and calibration.sensor_axis is None and _clocks_run(recording, calibration)
    return calibration, spans_of(recording) if plain else ()


def _clocks_run(recording: Recording, calibration: Calibration) -> bool:
    """Whether stamps increase and no sensor's clock jumped or drifted in the whole recording."""
    asked = Asked(recording, calibration, "smoother", given=False)
    sides = asked.sides
    point = asked.point(sides, ())
    known = known_sensors(sides[0])
    streams = [recording.acceleration, *(view.displacement for view, _ in known)]
    if any((np.diff(stream.time_ns) <= 0).any() for stream in streams):
        return False
    series = {view.sensor: ROWS[view.kind].series(view, part_of, None) for view, part_of in known}
    whole = FirstPass(sides, (), point.estimator, point.sensors, Outcome(), (), (series,))
    return not any(ran_apart(one) or one.levels or one.warnings for one in clocks_of(whole).values())


def between(recording: Recording, calibration: Calibration, span: Span) -> Recording:
    """The part of a recording of tables within a span of the accelerometer's clock."""
    found = Recording(recording.file, recording.settings)
    vars(found)["acceleration"] = _cut(recording.acceleration, span.holds(recording.acceleration.time_ns))
    for own, view in zip(found.views, recording.views, strict=True):
        known = calibration.of_sensor(view.own, view.companions)
        vars(own)["displacement"] = _cut(view.displacement, span.holds(read_with(view.displacement, known).time_ns))
    return found


def _cut(series: TimeSeries, rows: slice) -> TimeSeries:
    return replace(series, time_ns=series.time_ns[rows], value=series.value[rows])


def estimate_piece(recording: Recording, calibration: Calibration, span: Span) -> Result | None:
    """The result of a piece with SEAM_S around its own rows; None where the recording has to be estimated whole.

    A refusal is no reason to refuse the whole.
    """
    own = between(recording, calibration, span.wider(OVERLAP_S))
    asked = Asked(own, calibration, "smoother", given=False)
    first = first_pass(asked, None, silent)
    ran = clocks_of(first)
    if wrong_of(first) or any(map(ran_apart, ran.values())):
        return None
    checked = check(asked, first, ran)
    return with_rows(result_of(asked, first, smoothed(first, ran, checked), checked), span.wider(SEAM_S))


def with_rows(result: Result, span: Span) -> Result:
    """The result with the rows and events of a span alone."""
    rows = part(result.estimate, span.holds(result.estimate.time_ns))
    events = tuple(one for one in result.events if span.first_ns <= one.time_ns < span.end_ns)
    return replace(result, estimate=rows, events=events)


def seam(rows: Estimate, at_ns: int) -> Estimate:
    """The rows around an instant."""
    return part(rows, Span(at_ns, at_ns).wider(SEAM_S).holds(rows.time_ns))


def agree(before: Estimate, after: Estimate) -> bool:
    """Whether the rows of two pieces around the instant where they meet are the same within the stated rounding."""
    if not np.array_equal(before.time_ns, after.time_ns):
        return False
    std_m = np.sqrt(before.variance_m2)
    apart_m, wider_m = np.abs(before.displacement_m - after.displacement_m), np.abs(std_m - np.sqrt(after.variance_m2))
    return bool(
        (apart_m <= np.maximum(MAX_SHARE * std_m, MAX_DIFFERENCE_M)).all() and (wider_m <= MAX_SHARE * std_m).all()
    )


def joined_seams(seams: Sequence[tuple[Estimate, Estimate]]) -> bool:
    """Whether all pieces agree with the next one; seams: rows of each at its begin and at its end."""
    return all(agree(end, begin) for (_, end), (begin, _) in pairwise(seams))
