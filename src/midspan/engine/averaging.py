"""Sensors that average over an exposure: what the averaging took from fast motion, given back by the acceleration.

The estimator takes the acceleration for constant within an exposure T: T²/24 (a(t) − b), with its bias b. Here a
measurement gets what `signals.averaging` says beyond that, which is free of the bias and makes the relation exact at
any frequency. For that it, and the samples, wait half an exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.sensors import Seen
from midspan.records import NANOSECONDS, Channel, Measured, Samples, Source, joined, part, places
from midspan.signals.averaging import taken_by_averaging


def in_displacement_alone(channels: Sequence[Channel]) -> bool:
    """Whether all that measures are displacement sensors: a camera or radar is predicted up to its own instant, so that
    no samples may wait, and averaging is taken by its first term.
    """
    return all(one.source == Source.DISPLACEMENT for one in places(channels))


@dataclass(frozen=True, slots=True)
class AveragingState:
    """Samples of the last exposure and those not given out yet, until when they were given out, and of each sensor the
    measurements that wait.
    """

    samples: Samples | None
    given_ns: int | None
    waiting: tuple[tuple[str, Measured], ...]


class Averaging:
    """Holds samples and measurements back by half of the longest exposure, and completes the measurements.

    channels: the estimator's, each with a sensor of its own. Without any with an exposure, or with others than those of
    displacement sensors among them, everything passes through at once.
    """

    def __init__(self, channels: Sequence[Channel]) -> None:
        alone = in_displacement_alone(channels)
        self.channels = {c: one for c, one in enumerate(channels) if alone and one.exposure_s > 0.0}
        longest_s = max((one.exposure_s for one in self.channels.values()), default=0.0)
        self._reach_ns = round(longest_s / 2.0 * NANOSECONDS)
        self._samples: Samples | None = None
        self._given_ns: int | None = None
        self._waiting: dict[str, Measured] = {}

    @property
    def state(self) -> AveragingState:
        """What waits."""
        return AveragingState(self._samples, self._given_ns, tuple(self._waiting.items()))

    def restore(self, state: AveragingState) -> None:
        """Go on from where `state` was read."""
        self._samples, self._given_ns, self._waiting = state.samples, state.given_ns, dict(state.waiting)

    def seen(self, seen: Seen) -> Seen:
        """What a sensor saw, without the measurements that wait for the acceleration."""
        if seen.measured is None or not np.isin(seen.measured.channel, list(self.channels)).any():
            return seen
        waiting = self._waiting.get(seen.sensor)
        self._waiting[seen.sensor] = seen.measured if waiting is None else joined([waiting, seen.measured])
        return replace(seen, measured=None)

    def sampled(self, samples: Samples) -> tuple[list[Seen], Samples]:
        """Measurements that are complete, and the samples that may follow them."""
        if not self.channels:
            return [], samples
        known = samples if self._samples is None else joined([self._samples, samples])
        return self._released(known, int(known.time_ns[-1]) - self._reach_ns)

    def finish(self) -> tuple[list[Seen], Samples | None]:
        """All that waits still, at the end of the records."""
        return ([], None) if self._samples is None else self._released(self._samples, int(self._samples.time_ns[-1]))

    def _released(self, known: Samples, until_ns: int) -> tuple[list[Seen], Samples]:
        """What lies up to an instant, by all samples that are known."""
        first = 0 if self._given_ns is None else int(np.searchsorted(known.time_ns, self._given_ns, side="right"))
        last = max(int(np.searchsorted(known.time_ns, until_ns, side="right")), first)
        ready, oldest_ns = [], int(known.time_ns[max(last - 1, 0)])
        for sensor, measured in list(self._waiting.items()):
            due = int(np.searchsorted(measured.time_ns, until_ns, side="right"))
            if due:
                ready.append(Seen(sensor, self._completed(part(measured, slice(due)), known)))
            self._waiting[sensor] = part(measured, slice(due, None))
            oldest_ns = min([oldest_ns, *self._waiting[sensor].time_ns[:1].tolist()])
        begin = int(np.searchsorted(known.time_ns, oldest_ns - self._reach_ns)) - 1
        self._samples = part(known, slice(max(begin, 0), None))
        self._given_ns = int(known.time_ns[last - 1]) if last > first else self._given_ns
        return ready, part(known, slice(first, last))

    def _completed(self, measured: Measured, known: Samples) -> Measured:
        """The measurements without what averaging took from them beyond its first term."""
        value = measured.value.copy()
        for c, channel in self.channels.items():
            own, acceleration = measured.channel == c, known.value_m_s2[:, channel.axis]
            value[own] -= channel.units_per_m * taken_by_averaging(
                known.time_ns, acceleration, measured.time_ns[own], channel.exposure_s, beyond_first_term=True
            )
        return replace(measured, value=value)
