"""The second pass over what the estimator decided: `smoother` over a whole log, `lag` over a sliding window."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.fusion.blocks import Rows, rows_of
from midspan.fusion.estimator import BLOCK, MAX_WAITING, Log, pushed, restore
from midspan.fusion.model import EstimatorSettings
from midspan.records import Estimate, Event, Floats, Measured, Samples


def smooth(log: Log, settings: EstimatorSettings) -> tuple[Estimate, ...]:
    """The rows of each axis, smoothed by the whole record; log: of an estimator that has finished."""
    return log.smoothed(settings)


@dataclass(frozen=True, slots=True)
class LagState:
    """All that a fixed-lag stream remembers, as the core writes it: bytes with a version and a check sum."""

    core: NDArray[np.uint8]


class Lag:
    """The estimator's rows given out `lag_samples` or up to a quarter more later, smoothed by what came until then.

    The window moves on in hops of a quarter of the lag, counted in samples from the first one, so that any cutting of
    the input gives the same rows. Innovations and events are those of the estimator, as they come.
    """

    def __init__(self, settings: EstimatorSettings, lag_samples: int, *, max_waiting: int | None = None) -> None:
        self.settings, self.lag_samples, self._max_waiting = settings, lag_samples, max_waiting or MAX_WAITING
        self.core = _core.Lag(settings, lag_samples, waiting=self._max_waiting, block=BLOCK)

    def push(self, record: Samples | Measured | Event) -> list[Rows]:
        """Take one block, as `Estimator.push`."""
        return pushed(self.core, record, self.settings, self._max_waiting)

    def finish(self) -> list[Rows]:
        """The rows that are held still, and what the estimator says at the end."""
        return [rows_of(one, self.settings.channels, self._max_waiting) for one in self.core.finish()]

    def predict(self, channel: int, time_ns: int) -> tuple[float, float]:
        """As `Estimator.predict`."""
        return self.core.predict(channel, time_ns) or (np.nan, np.inf)

    @property
    def parameters(self) -> tuple[Floats, Floats]:
        """As `Estimator.parameters`."""
        values, variances = self.core.parameters()
        return np.array(values), np.array(variances)

    @property
    def state(self) -> LagState:
        """All that the stream remembers."""
        return LagState(np.frombuffer(self.core.state(), dtype=np.uint8))

    def restore(self, state: LagState) -> None:
        """Go on from a state of a stream with the same settings."""
        restore(self.core, state.core)
