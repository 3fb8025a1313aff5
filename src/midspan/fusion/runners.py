"""Running a fusion method by its name over a whole record of plain arrays."""

from collections.abc import Callable
from importlib import import_module

from midspan.checks import option
from midspan.fusion.methods import METHODS
from midspan.fusion.streams import MethodSettings, Smoothed
from midspan.records import Acceleration, Displacement

# What a row of METHODS names: acceleration, displacement, settings and the smoothed record where it is known already.
Run = Callable[[Acceleration, Displacement, MethodSettings, Smoothed | None], Smoothed]


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
    on, with the innovations and events. Raises UsageError for an unknown name.
    """
    module, function = METHODS[option("method", name, METHODS)].run.split(":")
    run: Run = getattr(import_module(module), function)
    return run(acceleration, displacement, settings or MethodSettings(), path)
