"""Running a fusion method by its name over a whole record of plain arrays."""

from dataclasses import replace

import numpy as np

from midspan.checks import option
from midspan.errors import UsageError
from midspan.fusion.entry import require_record
from midspan.fusion.methods import METHODS, Pass, named, no_literal_form
from midspan.fusion.on_series import MakeMethod, OnSeries, Usual
from midspan.fusion.streams import MethodSettings, Smoothed, filtered, pushed, smooth, sources_of
from midspan.records import NANOSECONDS, Acceleration, Displacement, Nanoseconds, Source, part, seconds


def run_method(
    name: str,
    acceleration: Acceleration,
    displacement: Displacement,
    settings: MethodSettings | None = None,
) -> Smoothed:
    """Run the method `name` of `midspan methods` over a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order. Returns
    one row a sample, from the first measurement on, with the innovations and events. Raises UsageError for an unknown
    name, and for literal without a printed form.
    """
    row, settings = METHODS[option("method", name, METHODS)], settings or MethodSettings()
    if settings.literal and not row.literal:
        raise UsageError(f"{no_literal_form(name)}.")
    if row.takes_series(literal=settings.literal):
        return _on_series(named(row.on_series), acceleration, displacement, settings)
    kalman = settings.kalman
    if row.follows_noise:
        kalman = replace(kalman, noise_memory=settings.noise_memory)
    if row.rows is Pass.SMOOTHED:
        return smooth(acceleration, displacement, kalman)
    return filtered(acceleration, displacement, kalman, lag_s=settings.lag_s if row.rows is Pass.LAGGED else 0.0)


def _on_series(
    make: MakeMethod, acceleration: Acceleration, displacement: Displacement, settings: MethodSettings
) -> Smoothed:
    require_record(acceleration, displacement)
    usual = usual_of(acceleration, displacement)
    sensors = [Source(code).word for code in sources_of(displacement) if code != Source.PREDICTION]
    estimator = OnSeries(
        settings.kalman.estimator(sources_of(displacement)),
        [make(settings, usual)],
        sensors,
        max_waiting=len(displacement.time_ns) + 1,
    )
    delay_s = estimator.lag_samples * usual.step_s
    return pushed(estimator, acceleration, displacement, settings.kalman, delay_s=delay_s)


def usual_of(acceleration: Acceleration, displacement: Displacement) -> Usual:
    """What is usual of both series: the median steps, of several sensors those of the one that measures most."""
    usable = np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2)
    measured = part(displacement, usable)
    measured = part(measured, np.argsort(measured.time_ns, kind="stable"))
    step_s, speed_m_s = _step_s(acceleration.time_ns), 0.0
    main = part(measured, measured.source == np.bincount(measured.source, minlength=1).argmax())
    if len(main.time_ns) < 2:
        return Usual(step_s, step_s, speed_m_s)
    step, moved_m = np.diff(seconds(main.time_ns, 0)), np.diff(main.value_m)
    if (step > 0.0).any():
        speed_m_s = float(np.sqrt(np.mean((moved_m[step > 0.0] / step[step > 0.0]) ** 2)))
    return Usual(step_s, max(_step_s(main.time_ns), 1.0 / NANOSECONDS), speed_m_s)


def _step_s(time_ns: Nanoseconds) -> float:
    return float(np.median(np.diff(time_ns))) / NANOSECONDS
