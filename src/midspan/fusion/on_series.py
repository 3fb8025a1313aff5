"""A method that takes one series of displacements along an axis, as the papers' do: its rows replace the estimator's.

The estimator runs as well. It says which rows there are and what supports them, and its rows stand where the method has
none. Its band, together with the difference of the two, is the band of the method's rows: what a method as printed is
off by, its own equations do not know.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.blocks import Rows
from midspan.fusion.estimator import Estimator, Lag, State
from midspan.fusion.model import EstimatorSettings
from midspan.fusion.streams import MethodSettings
from midspan.records import (
    Acceleration,
    Displacement,
    Event,
    Floats,
    Measured,
    Nanoseconds,
    Samples,
    part,
)
from midspan.signals.health import Mask

# Samples that wait for the estimator's first rows at most.
MAX_HELD = 65536
# Of a record that no row of the method is in.
NO_ROWS = (
    "the method gives no row here: its window is longer than the record or than any part without a gap. The estimator "
    "supplies these rows."
)
# Before every stamp.
FIRST_NS = np.iinfo(np.int64).min


@dataclass(frozen=True, slots=True)
class MethodRows:
    """What a method has at samples (n,): displacement (m), velocity (m/s), whether there are any; what it reports."""

    displacement_m: Floats
    velocity_m_s: Floats
    valid: Mask
    events: tuple[Event, ...] = ()


@dataclass(frozen=True, slots=True)
class Usual:
    """What is usual of both series: the steps between samples and between displacements, s, the rms speed, m/s."""

    step_s: float
    frame_s: float
    speed_m_s: float


class SampleBuffer:
    """Columns (n,) at stamps (n,) that are kept until they are not needed any more, `MAX_HELD` and `more` at most."""

    def __init__(self, columns: int, more: int = 0) -> None:
        self.time_ns, self.columns = np.empty(0, dtype=np.int64), [np.empty(0) for _ in range(columns)]
        self._most = MAX_HELD + more

    def add(self, time_ns: Nanoseconds, *values: Floats) -> None:
        """Put further ones behind those that are there, of which the oldest go where they are too many."""
        self.drop_first(len(self.time_ns) - self._most)
        self.time_ns = np.concatenate((self.time_ns, time_ns))
        self.columns = [np.concatenate(pair) for pair in zip(self.columns, values, strict=True)]

    def at(self, time_ns: Nanoseconds) -> tuple[NDArray[np.int64], Mask]:
        """The places of stamps (k,), and whether each is there."""
        place = np.searchsorted(self.time_ns, time_ns)
        return place, np.isin(time_ns, self.time_ns)

    def drop_first(self, count: int) -> None:
        """Forget the first ones."""
        if count > 0:
            self.time_ns, self.columns = self.time_ns[count:], [column[count:] for column in self.columns]

    @property
    def state(self) -> tuple[Any, ...]:
        """Stamps and columns."""
        return (self.time_ns, *self.columns)

    @state.setter
    def state(self, state: tuple[Any, ...]) -> None:
        self.time_ns, *self.columns = state


class SeriesMethod(Protocol):
    """A method along one axis, made of `MethodSettings` and `Usual`; any cutting of its input gives the same rows.

    state: all that has an effect on what comes later, a tuple of plain values and arrays.
    """

    state: Any

    @property
    def delay_samples(self) -> int:
        """Samples after a row that it needs."""
        ...

    def wait(self, met: Displacement) -> None:
        """Take displacements that are finite and later than the last sample, in time order."""
        ...

    def push(self, acceleration: Acceleration) -> None:
        """Take further samples."""
        ...

    def rows(self, time_ns: Nanoseconds) -> MethodRows:
        """The rows at samples (n,), in order; what is before them is forgotten."""
        ...

    def predict(self, time_ns: int) -> tuple[float, float] | None:
        """Displacement (m) and its variance at a time after the last sample; None: as the estimator predicts."""
        ...


MakeMethod = Callable[[MethodSettings, Usual], SeriesMethod]
# Of the estimator; the last sample's stamp; of each axis that of the method, the newest displacement that it took, and
# whether it has given a row.
OnSeriesState = tuple[State, int, tuple[tuple[Any, int, bool] | None, ...]]


class OnSeries:
    """The estimator as a stream whose rows are those of a method along each axis that has one.

    The method takes the first target of its sensors that is seen at an instant, as the papers have one, counted from
    the first frame of the first sensor; that of another one lies where the estimator has its zero.
    """

    def __init__(
        self,
        settings: EstimatorSettings,
        methods: Sequence[SeriesMethod | None],
        sensors: Collection[str],
        *,
        log: bool = False,
        max_waiting: int | None = None,
    ) -> None:
        """methods: of each axis, None for the estimator's rows; sensors: names of those whose measurements it takes."""
        self.lag_samples = max((one.delay_samples for one in methods if one is not None), default=0)
        self._inner: Estimator | Lag = (
            Lag(settings, self.lag_samples, max_waiting=max_waiting)
            if self.lag_samples
            else Estimator(settings, log=log, max_waiting=max_waiting)
        )
        self._methods, self._newest_ns, self._last_ns = list(methods), [FIRST_NS] * len(methods), FIRST_NS
        self._gave = [False] * len(methods)
        self._has_zero = np.array([np.isfinite(one.zero_std_m) for one in settings.channels])
        self._taken = [
            np.array([one.axis == axis and one.sensor in sensors for one in settings.channels])
            for axis in range(len(methods))
        ]

    @property
    def settings(self) -> EstimatorSettings:
        """Those of the estimator."""
        return self._inner.settings

    @property
    def head(self) -> None:
        """No row comes before its time: a method's rows are its own from the first on."""
        return None

    @property
    def parameters(self) -> tuple[Floats, Floats]:
        """Those of the estimator, see there."""
        return self._inner.parameters

    @property
    def clock_steps(self) -> tuple[float, ...]:
        """Those of the estimator, see there."""
        return self._inner.clock_steps

    @property
    def clock_offsets(self) -> tuple[Floats, Floats]:
        """Those of the estimator, see there."""
        return self._inner.clock_offsets

    def push(self, record: Samples | Measured | Event) -> list[Rows]:
        """Take one block, as the estimator does."""
        for axis, method in enumerate(self._methods):
            if method is None:
                continue
            if isinstance(record, Measured):
                met = self._series(record, axis)
                if len(met.time_ns):
                    self._newest_ns[axis] = int(met.time_ns[-1])
                    method.wait(met)
            elif isinstance(record, Samples) and len(record.time_ns):
                value, density = record.value_m_s2[:, axis], record.noise_density[:, axis]
                method.push(Acceleration(record.time_ns, value, density))
        if isinstance(record, Samples) and len(record.time_ns):
            self._last_ns = int(record.time_ns[-1])
        return [self._replaced(rows) for rows in self._inner.push(record)]

    def finish(self) -> list[Rows]:
        """The rows that are held back still."""
        found = [self._replaced(rows) for rows in self._inner.finish()]
        missing = [axis for axis, method in enumerate(self._methods) if method is not None and not self._gave[axis]]
        if found and missing:
            ends_ns = [min(self._last_ns, self._newest_ns[axis]) for axis in missing]
            events = (Event(at, "literal", NO_ROWS, axis=axis) for at, axis in zip(ends_ns, missing, strict=True))
            found[-1] = replace(found[-1], events=(*found[-1].events, *events))
        return found

    def predict(self, channel: int, time_ns: int) -> tuple[float, float]:
        """Expected measurement of a channel at a time after the last sample, in its unit, and the variance of that."""
        expected, one = self._inner.predict(channel, time_ns), self.settings.channels[channel]
        method = self._methods[one.axis]
        # Where no samples come, holding the last one would lead away.
        own = None if method is None or np.isnan(expected[0]) else method.predict(time_ns)
        if own is None:
            return expected
        return one.units_per_m * (own[0] + self._zero_m(channel, time_ns)), one.units_per_m**2 * own[1]

    def _zero_m(self, channel: int, time_ns: int) -> float:
        """The zero of a channel relative to that of the first one along its axis, as the estimator has it; m."""
        channels = self.settings.channels
        if self._has_zero[channel]:
            return 0.0
        first = next(number for number, one in enumerate(channels) if one.axis == channels[channel].axis)
        expected_m, first_m = (
            self._inner.predict(number, time_ns)[0] / channels[number].units_per_m for number in (channel, first)
        )
        return expected_m - first_m

    @property
    def state(self) -> OnSeriesState:
        """All that is remembered besides the log."""
        own = tuple(
            None if method is None else (method.state, newest_ns, gave)
            for method, newest_ns, gave in zip(self._methods, self._newest_ns, self._gave, strict=True)
        )
        return self._inner.state, self._last_ns, own

    def restore(self, state: OnSeriesState) -> None:
        """Go on from a state of a stream with the same settings."""
        inner, self._last_ns, own = state
        self._inner.restore(inner)
        for axis, (method, kept) in enumerate(zip(self._methods, own, strict=True)):
            if method is not None and kept is not None:
                method.state, self._newest_ns[axis], self._gave[axis] = kept

    def _series(self, record: Measured, axis: int) -> Displacement:
        """What the method takes of measurements, in m."""
        channels, newest_ns = self.settings.channels, max(self._newest_ns[axis], self._last_ns)
        usable = self._taken[axis][record.channel] & np.isfinite(record.value) & np.isfinite(record.variance)
        taken = np.flatnonzero(usable & (record.time_ns > newest_ns))
        stamps, first = np.unique(record.time_ns[taken], return_index=True)
        taken = taken[first]
        units = np.array([one.units_per_m for one in channels])[record.channel[taken]]
        source = np.array([one.source for one in channels], dtype=np.uint8)[record.channel[taken]]
        value = record.value[taken] / units
        for k in np.flatnonzero(~self._has_zero[record.channel[taken]]):
            value[k] -= self._zero_m(int(record.channel[taken[k]]), int(stamps[k]))
        found = Displacement(stamps, value, record.variance[taken] / units**2, source)
        return part(found, np.isfinite(value))

    def _replaced(self, rows: Rows) -> Rows:
        if not rows.estimates or not len(rows.estimates[0].time_ns):
            return rows
        estimates, events = list(rows.estimates), list(rows.events)
        for axis, method in enumerate(self._methods):
            if method is None:
                continue
            one, own = estimates[axis], method.rows(estimates[axis].time_ns)
            self._gave[axis] |= bool(own.valid.any())
            apart = np.where(own.valid, own.displacement_m - one.displacement_m, 0.0)
            estimates[axis] = replace(
                one,
                displacement_m=np.where(own.valid, own.displacement_m, one.displacement_m),
                variance_m2=one.variance_m2 + apart**2,
                velocity_m_s=np.where(own.valid, own.velocity_m_s, one.velocity_m_s),
            )
            events += [replace(event, axis=axis) for event in own.events]
        return replace(rows, estimates=tuple(estimates), events=tuple(events))
