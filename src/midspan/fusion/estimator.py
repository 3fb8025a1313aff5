"""The estimator of one measuring point: samples and measurements in, displacement with its band out, one row a sample.

The core (`core/src/estimator`) filters and decides; here its numbers become records and sentences.
"""

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import DataError
from midspan.fusion.blocks import Rows, rows_of
from midspan.fusion.model import EstimatorSettings, ParameterKind
from midspan.records import Estimate, Event, Floats, Measured, Nanoseconds, Samples

# Measurements of a live point that may wait.
MAX_WAITING = 65536
# Samples that are run at once: bounds the memory.
BLOCK = 8192

State = NDArray[np.uint8]
"""All that a stream of the core remembers, as the core writes it: bytes with a version and a check sum."""


class Stream:
    """What `Estimator` and `Lag` have in common: records in, rows out, by a stream of the core."""

    def __init__(
        self,
        settings: EstimatorSettings,
        max_waiting: int | None,
        *,
        log: bool,
        rows: bool,
        lag_samples: int | None = None,
    ) -> None:
        self.settings, self._max_waiting, self.lag_samples = settings, max_waiting or MAX_WAITING, lag_samples or 0
        self.core = _core.Estimator(
            settings, log=log, rows=rows, waiting=self._max_waiting, block=BLOCK, lag_samples=lag_samples
        )

    def push(self, record: Samples | Measured | Event) -> list[Rows]:
        """Take one block; returns for samples the rows that are due, if any.

        Times increase from block to block of samples. A measurement that is not later than the last sample is left out,
        with an event. An event stands for stamps that went back: from then on clocks may have stepped.
        """
        if isinstance(record, Event):
            self.core.doubt(record.time_ns)
            return []
        if isinstance(record, Measured):
            self.core.measure(
                np.ascontiguousarray(record.time_ns, dtype=np.int64),
                np.ascontiguousarray(record.channel, dtype=np.int64),
                *(
                    np.ascontiguousarray(values, dtype=np.float64)
                    for values in (record.value, record.variance, record.reference_variance)
                ),
            )
            return []
        outputs = self.core.push(
            np.ascontiguousarray(record.time_ns, dtype=np.int64),
            np.ascontiguousarray(record.value_m_s2, dtype=np.float64),
            np.ascontiguousarray(record.noise_density, dtype=np.float64),
            np.ascontiguousarray(record.kind, dtype=np.uint8),
        )
        return [rows_of(output, self.settings.channels, self._max_waiting) for output in outputs]

    def finish(self) -> list[Rows]:
        """The rows that are held back still, and events that the record's end completes."""
        return [rows_of(output, self.settings.channels, self._max_waiting) for output in self.core.finish()]

    def predict(self, channel: int, time_ns: int) -> tuple[float, float]:
        """Expected measurement of a channel at a time after the last sample, in its unit, and the variance of that.

        The last acceleration is held over a step or two; NaN where no samples come. Until the filter and the channel's
        zero have begun only the acceleration tells: the variance is infinite before the filter begins and NaN after
        that, when measurements from before come too late.
        """
        return self.core.predict(channel, time_ns) or (np.nan, np.inf)

    @property
    def state(self) -> State:
        """All that is remembered besides the log."""
        return np.frombuffer(self.core.state(), dtype=np.uint8)

    def restore(self, state: State) -> None:
        """Go on from a state of a stream with the same settings."""
        restore(self.core, state)

    @property
    def head(self) -> Estimate | None:
        """Where rows come later: the main axis's row at the newest sample as `Estimator` gives it, not smoothed yet.

        None before the first row, and while a clock's step is looked for.
        """
        found = self.core.head() if self.lag_samples else None
        return None if found is None else Estimate(found[0], *found[1][0])

    @property
    def seeks_clock(self) -> bool:
        """Whether a sensor's clock may have stepped, and by how much is looked for."""
        return self.core.seeks_clock()

    @property
    def parameters(self) -> tuple[Floats, Floats]:
        """The parameters as estimated (k,) and their variances (k,)."""
        values, variances = self.core.parameters()
        return np.array(values), np.array(variances)

    @property
    def clock_steps(self) -> tuple[float, ...]:
        """By how much the clock of each channel (c,) was found to have stepped, s: a part of `clock_offsets`."""
        return tuple(self.core.clock_offsets())

    @property
    def clock_offsets(self) -> tuple[Floats, Floats]:
        """What is to be added to the stamps of each channel (c,), s, as estimated, and the variance of that (c,); NaN
        where its clock is not estimated.
        """
        offsets, spread = np.array(self.core.clock_offsets()), np.full(len(self.settings.channels), np.nan)
        for one, value, variance in zip(self.settings.parameters, *self.parameters, strict=True):
            if one.kind is ParameterKind.CLOCK_OFFSET:
                offsets[list(one.channels)] += value
                spread[list(one.channels)] = variance
        return offsets, spread


class Estimator(Stream):
    """The estimator as a stream: any cutting of the input into pushes gives the same rows.

    Measurements wait for the samples that cover their time; rows are held back until the first few have come. log: keep
    all that a second pass needs. rows: whether rows are given out, which only a second pass does not need. max_waiting:
    this many measurements may wait for samples, older ones are dropped; None: MAX_WAITING.
    """

    def __init__(
        self, settings: EstimatorSettings, *, log: bool = False, rows: bool = True, max_waiting: int | None = None
    ) -> None:
        super().__init__(settings, max_waiting, log=log, rows=rows)

    @property
    def logged_samples(self) -> Samples:
        """All samples that were logged, from the filter's beginning on."""
        logged = self.core.logged_samples()
        assert logged is not None
        time_ns, value, density, kind = logged
        shape = (len(time_ns), self.settings.axes)
        return Samples(time_ns, value.reshape(shape), density.reshape(shape), kind)

    @property
    def went_back_ns(self) -> Nanoseconds:
        """Instants (k,) from which on clocks were in doubt, as stamps had gone back."""
        return np.array(self.core.went_back_ns(), dtype=np.int64)

    def smoothed(self, settings: EstimatorSettings | None = None, *, logged: bool = True) -> tuple[Estimate, ...]:
        """The second pass over what was decided, once finished: the rows of each axis, smoothed by the whole record.

        logged: take the filters that were logged where they are right (the settings are the same), which gives the same
        bits as running all again.
        """
        settings = settings or self.settings
        time_ns, axes = self.core.smooth(settings, logged and settings == self.settings)
        return tuple(Estimate(time_ns, *axis) for axis in axes)


class Lag(Stream):
    """The estimator's rows given out `lag_samples` or up to a quarter more later, smoothed by what came until then.

    The window moves on in hops of a quarter of the lag, counted in samples from the first one, so that any cutting of
    the input gives the same rows. Innovations and events are those of the estimator, as they come.
    """

    def __init__(self, settings: EstimatorSettings, lag_samples: int, *, max_waiting: int | None = None) -> None:
        super().__init__(settings, max_waiting, log=True, rows=False, lag_samples=lag_samples)


def restore(core: _core.Estimator | _core.PrintedFilter, state: State) -> None:
    """Let the core go on from its own bytes; DataError where they are not of a stream with the same settings."""
    try:
        core.restore(state.tobytes())
    except ValueError as error:
        raise DataError(
            "A state must be complete and come from this version of midspan with the same settings; received one that "
            f"is not ({error}). Start without it."
        ) from None
