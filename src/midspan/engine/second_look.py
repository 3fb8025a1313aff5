"""What the whole record tells of its first pass: clocks that jump or drift, scales that do not fit; then once more.

Only `smoother` looks again: the causal methods give what was known at the time.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from midspan.calibration.one_clock import OneClock, one_clock
from midspan.engine.point import Support
from midspan.engine.sensor_series import SensorSeries, series_of
from midspan.engine.stream import BACKWARDS, KINDS
from midspan.fusion.blocks import Rows
from midspan.fusion.estimator import BLOCK, Estimator
from midspan.fusion.model import EstimatorSettings, ParameterKind
from midspan.fusion.streams import KalmanSettings
from midspan.records import Acceleration, Channel, Displacement, Event, Measured, Nanoseconds, joined, part
from midspan.signals.stamps import shown


def clocks(
    series: Mapping[str, SensorSeries], acceleration: Acceleration, kalman: KalmanSettings, shared: Collection[str]
) -> dict[str, OneClock]:
    """How the clock of each sensor ran, by what it measured along the main axis; shared: names of those whose clock is
    the accelerometer's, so that no drift is looked for.
    """
    found = {}
    for name, one in series.items():
        level = float(np.nanmedian(one.value_m)) if np.isfinite(one.value_m).any() else 0.0
        block = replace(one.displacement, value_m=one.value_m - level)
        found[name] = one_clock(block, acceleration, kalman, name, shared=name in shared)
    return found


def ran_apart(clock: OneClock) -> bool:
    """Whether a clock jumped or drifted."""
    return bool(clock.jumps) or clock.course is not None


def on_clock(series: SensorSeries, clock: OneClock) -> SensorSeries:
    """A sensor's series with the jumps and the drift of its clock taken out."""
    return series_of(series.sensor, series.source, clock.also(series.displacement).measured)


def left_out_event(name: str, stamps: Nanoseconds) -> Event:
    """The event of a sensor's values at some stamps (k,) that are left out."""
    text = (
        f"{name}: {len(stamps)} values from {shown(int(stamps[0]))} to {shown(int(stamps[-1]))} contradict the "
        "acceleration and its other values; they are left out. The sensor was stuck or occluded."
    )
    return Event(int(stamps[0]), "rejected", text)


def on_its_clock(measured: Measured, channels: Sequence[Channel], clock: OneClock) -> Measured:
    """A sensor's measurements with the jumps and the drift of its clock taken out, channel by channel."""
    blocks = []
    for number in np.unique(measured.channel):
        own = part(measured, measured.channel == number)
        source = np.full(len(own.time_ns), channels[int(number)].source, dtype=np.uint8)
        moved = clock.also(Displacement(own.time_ns, own.value, own.variance, source)).measured
        blocks.append(replace(own, time_ns=moved.time_ns, value=moved.value_m, variance=moved.variance_m2))
    return joined(blocks)


def with_scales(settings: EstimatorSettings, found: Mapping[tuple[str, int], float]) -> EstimatorSettings:
    """The settings with scale errors of these relative standard deviations at least, by sensor and axis.

    That of a sensor whose unit is right is the accelerometer's gain error.
    """
    scaled = {
        number for one in settings.parameters if one.kind is not ParameterKind.CLOCK_OFFSET for number in one.channels
    }
    in_metres = [one for number, one in enumerate(settings.channels) if number not in scaled]
    parameters = []
    for parameter in settings.parameters:
        if parameter.kind is ParameterKind.SCALE_ERROR:
            own = [settings.channels[parameter.channels[0]]]
        elif parameter.kind is ParameterKind.GAIN_ERROR:
            own = [channel for channel in in_metres if channel.axis == parameter.axis]
        else:
            own = []
        off = [found.get((channel.sensor, channel.axis), 0.0) for channel in own]
        parameters.append(replace(parameter, std=max([parameter.std, *off])))
    return replace(settings, parameters=tuple(parameters))


def without_steps(settings: EstimatorSettings) -> EstimatorSettings:
    """The settings for a record with a crowd of outliers, in which no steps of clocks and zeros are considered.

    Chance makes such a step of a few outliers that agree. What the whole record says of clocks is known before
    (`clocks`), and a zero that does step is found as a motion that the accelerometer did not feel.
    """
    still = tuple((0.0, 0.0) for _ in settings.motion)
    return replace(settings, rates=replace(settings.rates, shift=0.0), motion=still)


def once_more(
    settings: EstimatorSettings, first: Estimator, measured: Sequence[Measured]
) -> tuple[Estimator, list[Rows]]:
    """The estimator run again over the samples and measurements of a whole record, as the first pass logged it.

    Where stamps went back in the first pass they do so again: the samples are cut there.
    """
    estimator, out, samples = Estimator(settings, log=True), list[Rows](), first.logged_samples
    rows = joined(measured)
    rows = part(rows, np.argsort(rows.time_ns, kind="stable"))
    back_ns = first.went_back_ns
    cuts = np.searchsorted(samples.time_ns, back_ns, side="right")
    edges = np.unique(np.concatenate((np.arange(0, len(samples.time_ns), BLOCK), cuts, [len(samples.time_ns)])))
    done = 0
    for first, last in pairwise(edges.tolist()):
        for time_ns in back_ns[cuts == first].tolist():
            estimator.push(Event(time_ns, KINDS[BACKWARDS], "Stamps went back."))
        block = part(samples, slice(first, last))
        due = int(np.searchsorted(rows.time_ns, block.time_ns[-1], side="right"))
        estimator.push(part(rows, slice(done, due)))
        out += estimator.push(block)
        done = due
    out += estimator.finish()
    return estimator, Support().after(out)[1]
