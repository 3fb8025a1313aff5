"""Running a fusion method by its name over a whole record of plain arrays."""

from collections.abc import Callable
from dataclasses import replace

from midspan.checks import option
from midspan.errors import UsageError
from midspan.fusion.methods import METHODS, Pass, named, no_literal_form
from midspan.fusion.streams import MethodSettings, Smoothed, filtered, smooth
from midspan.records import Acceleration, Displacement

# What `on_series` of METHODS names: acceleration, displacement, settings, and the smoothed record where it is known.
OnSeries = Callable[[Acceleration, Displacement, MethodSettings, Smoothed | None], Smoothed]


def run_method(
    name: str,
    acceleration: Acceleration,
    displacement: Displacement,
    settings: MethodSettings | None = None,
    path: Smoothed | None = None,
) -> Smoothed:
    """Run the method `name` of `midspan methods` over a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order; path: the
    smoothed record, for a method that needs it; None: it is made. Returns one row a sample, from the first measurement
    on, with the innovations and events. Raises UsageError for an unknown name, and for literal without a printed form.
    """
    row, settings = METHODS[option("method", name, METHODS)], settings or MethodSettings()
    if settings.literal and not row.literal:
        raise UsageError(f"{no_literal_form(name)}.")
    if row.takes_series(literal=settings.literal):
        run: OnSeries = named(row.on_series)
        return run(acceleration, displacement, settings, path)
    kalman = settings.kalman
    if row.follows_noise:
        kalman = replace(kalman, noise_memory=settings.noise_memory)
    if row.rows is Pass.SMOOTHED:
        return smooth(acceleration, displacement, kalman)
    return filtered(acceleration, displacement, kalman, lag_s=settings.lag_s if row.rows is Pass.LAGGED else 0.0)
