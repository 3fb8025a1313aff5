"""Methods that take one series of displacements: the papers' filters, and adaptive-kalman as printed.

The series is what the sensors measured along an axis, each in its turn, on the zero that the engine's estimator found.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from midspan.calibration.one_clock import OneClock
from midspan.engine.channels import clock_std_s
from midspan.engine.second_look import on_clock
from midspan.engine.sensor_series import SensorSeries
from midspan.errors import UntrustedError
from midspan.fusion.blocks import VELOCITY_WITHIN
from midspan.fusion.path import at
from midspan.fusion.runners import run_method
from midspan.fusion.streams import MethodSettings, Smoothed, no_innovation
from midspan.notices import Notice
from midspan.papers.printed.adaptive import speed_of
from midspan.papers.printed.complementary import OUTLIER_STD
from midspan.papers.printed.in_turn import in_turn
from midspan.recording.estimate import Asked, Checked, FirstPass, Found, smoothed
from midspan.recording.tracked import offsets_of
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Event,
    Floats,
    Measured,
    Nanoseconds,
    joined,
    part,
)
from midspan.signals.health import unknown_density
from midspan.signals.stamps import shown

# Noise estimated by a method as printed, over that of its start, beyond which it is called a run-away.
RUN_AWAY = 10.0


def one_series(
    series: Mapping[str, SensorSeries],
    path: Estimate,
    restarts_ns: Mapping[str, Nanoseconds],
    *,
    gated: bool = True,
) -> Displacement:
    """What the sensors measured, each in its turn, in time order; path: smoothed displacement.

    gated: without outliers. The zero of each sensor is moved onto the path's; a single sensor that is not gated keeps
    its own, as the papers' filters have it. restarts_ns (k,): instants from which on a radar's is a new one.
    """
    blocks = []
    for number, (name, one) in enumerate(series.items()):
        # The number stands for the sensor until it is known whose turn it is: there may be several of a kind.
        block = replace(one.displacement, source=np.full(len(one.time_ns), number, dtype=np.uint8))
        expected, variance = at(path, block.time_ns)
        seen = np.isfinite(block.value_m) & np.isfinite(block.variance_m2)
        apart = block.value_m - expected
        edges = [0, *np.searchsorted(block.time_ns, restarts_ns.get(name, ())), len(apart)]
        if gated or len(series) > 1 or len(edges) > 2:
            for span in (slice(first, last) for first, last in pairwise(edges)):
                apart[span] -= np.median(apart[span][seen[span]]) if seen[span].any() else 0.0
        far = gated & seen & (apart**2 > OUTLIER_STD**2 * (block.variance_m2 + variance))
        blocks.append(replace(block, value_m=np.where(far, np.nan, expected + apart)))
    both = joined(blocks)
    found = in_turn(part(both, np.argsort(both.time_ns, kind="stable")))
    sources = np.array([one.source for one in series.values()], dtype=np.uint8)
    return replace(found, source=sources[found.source])


def with_levels_since(
    rows: Estimate, path: Estimate, measured: Displacement, restarts_ns: Mapping[str, Nanoseconds]
) -> Estimate:
    """The rows with the path's variance in theirs from the outage before the first restart on: the level is the path's.

    measured: the series that the rows rest on.
    """
    firsts = [int(stamps[0]) for stamps in restarts_ns.values() if len(stamps)]
    if not firsts:
        return rows
    before = measured.time_ns[np.isfinite(measured.value_m) & (measured.time_ns < min(firsts))]
    begin = before[-1] if len(before) else min(firsts)
    level = np.where(rows.time_ns > begin, at(path, rows.time_ns)[1], 0.0)
    return replace(rows, variance_m2=rows.variance_m2 + level)


def run_on_series(
    acceleration: Acceleration,
    measured: Displacement,
    method: str,
    settings: MethodSettings,
    path: Estimate | None = None,
    *,
    rate_hz: float,
) -> Smoothed:
    """The rows of a method over the acceleration of an axis and one series; UntrustedError where it ran away.

    settings: with what is known of the axis in `kalman`; path: smoothed displacement; None: of the series itself, where
    it is needed; rate_hz: of the acceleration.
    """
    speed_m_s = speed_of(measured) if path is None else rms(path.velocity_m_s)
    kalman = replace(settings.kalman, velocity_std=VELOCITY_WITHIN * speed_m_s)
    known = None if path is None else Smoothed(path, no_innovation(), ())
    if settings.literal:
        acceleration = from_first_measurement(acceleration, measured, rate_hz)
    found = run_method(method, acceleration, measured, replace(settings, kalman=kalman), known)
    rows = found.estimate
    finite = np.isfinite(rows.displacement_m) & np.isfinite(rows.variance_m2)
    if finite.all():
        return found
    begin = shown(int(rows.time_ns[np.argmin(finite)]))
    raise UntrustedError(
        f"{method} ran away: its rows must be finite numbers, and from {begin} on they are not. "
        "Leave fusion.literal out, or choose another fusion.method."
    )


def from_first_measurement(acceleration: Acceleration, measured: Displacement, rate_hz: float) -> Acceleration:
    """Put a sample before the first measurement where that comes first: the zero belongs to it."""
    first, start = int(measured.time_ns[0]), int(acceleration.time_ns[0])
    if first >= start or start - first > 2 * NANOSECONDS:
        return acceleration
    value = float(np.mean(acceleration.value_m_s2[:100]))
    # A whole sample's interval at least: over nanoseconds the step to the first sample would be an endless slope.
    begin = min(first - 1, start - round(NANOSECONDS / rate_hz))
    before = Acceleration(np.array([begin]), np.array([value]), acceleration.noise_density[:1])
    widened = acceleration.noise_density.copy()
    widened[0] += unknown_density(acceleration.value_m_s2, rate_hz)
    return joined([before, replace(acceleration, noise_density=widened)])


def taken(series: SensorSeries, measured: Measured) -> SensorSeries:
    """The series with nothing where the estimator was given no measurement of the sensor: another one measured."""
    return replace(series, value_m=np.where(np.isin(series.time_ns, measured.time_ns), series.value_m, np.nan))


def rms(values: Floats) -> float:
    """Root mean square of values (n,) that are finite."""
    return float(np.sqrt(np.nanmean(values**2)))


def with_uncertain(rows: Estimate, zero_variance_m2: float, scale_std: float, clock_std_s: float) -> Estimate:
    """The rows with what zero, scale and clock of the calibration may be off by in their variance.

    The whole displacement goes with the scale's error, and its velocity with the clock's: what these methods take from
    the accelerometer does not, so this is the most that it can be.
    """
    more: Floats = (scale_std * rows.displacement_m) ** 2 + (clock_std_s * rows.velocity_m_s) ** 2
    return replace(rows, variance_m2=rows.variance_m2 + zero_variance_m2 + more)


def literal_warnings(measured: Displacement, done: Smoothed) -> list[Notice]:
    """What to know of the adaptive filter as printed; the FIR methods need no such word."""
    if done.variance_m2 is None or not len(done.variance_m2):
        return []
    found = [
        Notice(
            "literal",
            "fusion.literal: the filter was run exactly as printed, without bias, gate and limits. Its own covariance "
            "does not hold its error; the band was widened by what the innovations show.",
        )
    ]
    declared = float(np.median(measured.variance_m2[np.isfinite(measured.variance_m2)]))
    grown = float(np.sqrt(np.max(done.variance_m2) / max(declared, done.variance_m2[0])))
    if grown > RUN_AWAY:
        found.append(
            Notice(
                "literal",
                f"fusion.literal: the estimated noise grew to {grown:.3g} times that of the start: it runs away, most "
                "often under a bias of the accelerometer. Leave fusion.literal out.",
            )
        )
    share = float(np.mean(done.variance_m2 < 0.0))
    if share > 0.0:
        found.append(
            Notice(
                "literal", f"fusion.literal: equation 20 gave a negative variance in {100 * share:.2g} % of the frames."
            )
        )
    return found


def on_series(asked: Asked, first: FirstPass, ran: Mapping[str, OneClock], checked: Checked) -> Found:
    """The rows of a method that takes one series; along an axis without an accelerometer those of the smoother."""
    known = first.estimator.settings
    restarts_ns = {name: log.restarts_ns for name, log in first.outcome.radars.items()}
    # What nothing measured shows is no reason to take a farther measurement for right: it enters at the end.
    found, method = smoothed(first, ran, checked, alone=True), asked.by_settings
    gain = asked.calibration.gain_std(asked.recording.accelerometer.scale_std, given=asked.given)
    rows, innovations = list(found.rows), list(found.innovations)
    warnings = list(found.warnings)
    events: list[Event] = []
    for axis, side in enumerate(first.sides):
        tilt_m2 = known.unseen_std_m[axis] ** 2
        if not side.recording.fused:
            rows[axis] = replace(rows[axis], variance_m2=rows[axis].variance_m2 + 2.0 * tilt_m2)
            continue
        series = first.at_instants(axis)
        if asked.recording.settings.fusion.switching == "matches":
            series = {name: taken(one, first.outcome.measured_by(name)) for name, one in series.items()}
        named = {name: on_clock(one, ran[name]) for name, one in series.items()}
        # The filter as printed takes every measurement; what it wins by a gate would not be its own.
        printed = method.literal and asked.row.rows is not None
        measured = one_series(named, found.rows[axis], restarts_ns, gated=not printed)
        own, rate_hz = replace(method, kalman=side.kalman), side.prepared.rate_hz
        done = run_on_series(side.acceleration, measured, asked.method, own, found.rows[axis], rate_hz=rate_hz)
        scale_std = float(np.hypot(max(checked.scale_std[axis][name] for name in named), gain))
        clock_std = max(clock_std_s(one) for one in offsets_of(first.sides[0], first.tracked_cameras).values())
        own_rows = replace(done.estimate, variance_m2=known.misfit[axis] * done.estimate.variance_m2)
        level_m2 = known.misfit[axis] * found.zero_variance_m2[axis] + 2.0 * tilt_m2
        own_rows = with_uncertain(own_rows, level_m2, scale_std, clock_std)
        own_rows = with_levels_since(own_rows, found.rows[axis], measured, restarts_ns)
        rows[axis] = part(own_rows, np.isin(own_rows.time_ns, found.rows[axis].time_ns))
        innovations[axis] = done.innovation if len(done.innovation.time_ns) else innovations[axis]
        events += done.events
        found = replace(found, delay_s=max(found.delay_s, done.delay_s))
        warnings += literal_warnings(measured, done) if method.literal else []
    return replace(
        found,
        rows=tuple(rows),
        zero_variance_m2=tuple(
            known.misfit[axis] * zero + (0.0 if known.zero_ns is None else known.unseen_std_m[axis] ** 2)
            for axis, zero in enumerate(found.zero_variance_m2)
        ),
        innovations=tuple(innovations),
        events=(*found.events, *events),
        warnings=tuple(warnings),
    )
