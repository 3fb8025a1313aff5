"""A radar's stage as printed (Ma et al., doi:10.1016/j.ymssp.2022.109582): equations 10 and 12 to 16 frame by frame.

One receiver, the whole bin, the ramp's start frequency as the carrier. Each phase takes the cycle nearest to the one
that its two predecessors and the acceleration predict; a frame that never arrived takes the predicted phase and is no
measurement. Nothing is judged and nothing is left out, and a lost cycle is not found again.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.channels import Table, ages, clock_std_s
from midspan.engine.radar_target import FollowedTarget
from midspan.engine.sensors import Expect, RadarSensor, Seen
from midspan.fusion.model import ParameterKind
from midspan.papers.printed.radar_phase import printed_phase_per_m
from midspan.radar.chirp import RadarInfo
from midspan.radar.frames import together
from midspan.records import (
    NANOSECONDS,
    Channel,
    Event,
    Floats,
    Measured,
    PhaseMeasurement,
    RangeFrame,
    Samples,
    Source,
    Status,
)

TURN = 2.0 * math.pi
# Through more frames than this that never arrived the phase is not predicted: it counts anew.
MAX_MISSING = 10_000
# A phase that goes on at half a cycle a frame for this long, s, has lost cycles: no structure moves so.
RUN_AWAY_S = 2.0
RAN_AWAY = (
    "the printed unwrapping (fusion.literal) lost cycles and ran away (equations 12 to 15 do not return): the "
    "displacement is wrong from there on. Leave fusion.literal out."
)


class PrintedChain:
    """The target's wrapped phase in each frame."""

    state = ()

    def __init__(self, item: FollowedTarget) -> None:
        self.targets, self.bins = (item,), item.bins

    def restore(self, state: tuple[()]) -> None:
        """Nothing is remembered."""

    def push(self, frame: RangeFrame, predictions: Sequence[Any] | None = None) -> tuple[PhaseMeasurement, ...]:
        """The wrapped phase, NaN in a frame that was not received; its variance is E², the only error that is known."""
        (item,) = self.targets
        (z,) = together(frame.phasors[None], item.target, frame.valid[None])[0]
        seen = bool(np.isfinite(z))
        std_rad = item.target.noise_m / abs(item.target.conversion_factor) * item.phase_per_m
        status = Status.TRACKING if seen else Status.COASTING
        phase = float(np.angle(z)) if seen else math.nan
        strength = float(abs(z)) / item.target.amplitude if seen else 0.0
        return (PhaseMeasurement(frame.time_ns, phase, std_rad**2 if seen else math.inf, 0.0, status, strength),)


class PrintedRadar(RadarSensor):
    """A radar whose frames wait for the acceleration at their instants."""

    def __init__(self, name: str, chain: PrintedChain, channel: int, bias_m_s2: float) -> None:
        super().__init__(name, chain, [channel])  # type: ignore[arg-type]
        (item,) = chain.targets
        self._period_ns, self._bias = round(item.period_s * NANOSECONDS), bias_m_s2
        # rad per frame and frame that an acceleration of 1 m/s² adds.
        self._rad = item.phase_per_m / item.target.conversion_factor * item.period_s**2
        self._waiting: list[PhaseMeasurement] = []
        # Samples since the newest frame; its stamp and phase, the phase before it and that of the zero; for how many
        # frames it has gone on faster than half a cycle a frame, and where that began.
        self._time_ns, self._felt = np.empty(0, dtype=np.int64), np.empty(0)
        self._last_ns, self._last, self._before, self._zero = 0, math.nan, math.nan, math.nan
        self._runs, self._since = 0, math.nan

    @property
    def unseen(self) -> str:
        """As printed nothing is judged."""
        return ""

    @property
    def state(self) -> tuple[Any, ...]:
        """Everything that changes from frame to frame."""
        followed = self._last_ns, self._last, self._before, self._zero, self._runs, self._since
        return tuple(self._waiting), self._time_ns, self._felt, followed

    def restore(self, state: tuple[Any, ...]) -> None:
        """Go on from a `state` taken earlier."""
        waiting, self._time_ns, self._felt, followed = state
        self._waiting = list(waiting)
        self._last_ns, self._last, self._before, self._zero, self._runs, self._since = followed

    def push(self, record: RangeFrame, expect: Expect) -> None:  # type: ignore[override]
        """Take a frame, which waits."""
        self._waiting += self.chain.push(record)

    def reached(self, samples: Samples) -> Seen | None:  # type: ignore[override]
        """The phases of the frames that the samples reach."""
        self._time_ns = np.concatenate((self._time_ns, samples.time_ns))
        self._felt = np.concatenate((self._felt, samples.value_m_s2[:, 0] - self._bias))
        due = [one for one in self._waiting if one.time_ns <= samples.time_ns[-1]]
        self._waiting = self._waiting[len(due) :]
        events: list[Event] = []
        found = tuple(self._unwrapped(one, events) for one in due)
        oldest_ns = max(self._last_ns, int(samples.time_ns[-1]) - MAX_MISSING * self._period_ns)
        first = max(int(np.searchsorted(self._time_ns, oldest_ns, side="right")) - 1, 0)
        self._time_ns, self._felt = self._time_ns[first:], self._felt[first:]
        if not found:
            return None
        columns = ((one.phase_rad, one.variance_rad2, one.reference_variance_rad2) for one in found)
        value, variance, reference = np.array(list(columns), dtype=np.float64).T
        stamps = np.array([one.time_ns for one in found], dtype=np.int64)
        channel = np.full(len(found), self.channels[0], dtype=np.int64)
        return Seen(self.name, Measured(stamps, channel, value, variance, reference), found, tuple(events))

    def _unwrapped(self, one: PhaseMeasurement, events: list[Event]) -> PhaseMeasurement:
        """A frame's phase, counted from the first of two on end that were received, which must not wrap."""
        steps = max(round((one.time_ns - self._last_ns) / self._period_ns), 1)
        if steps > MAX_MISSING:
            self._last = math.nan
        seen, before, last = math.isfinite(one.phase_rad), self._before, self._last
        if math.isnan(last) or (math.isnan(before) and not (seen and steps == 1)):
            before = math.nan
            phase = self._zero = one.phase_rad
        else:
            predicted = last
            for felt in () if math.isnan(before) else self._acceleration(one.time_ns, steps):
                before, last = last, 2.0 * last - before + self._rad * felt
                predicted = last
            before = self._last if math.isnan(before) else before
            phase = _nearest(one.phase_rad, predicted) if seen else predicted
        self._runs, self._since = (self._runs + 1, self._since) if abs(phase - before) > math.pi else (0, phase)
        if self._runs == round(RUN_AWAY_S * NANOSECONDS / self._period_ns):
            events.append(Event(one.time_ns, "contradiction", f"{self.name}: {RAN_AWAY}"))
        self._before, self._last, self._last_ns = before, phase, one.time_ns
        # What runs is as uncertain as it is large: while it runs nobody knows whether cycles were lost.
        common = (phase - self._since) ** 2
        return replace(one, phase_rad=phase - self._zero if seen else math.nan, reference_variance_rad2=common)

    def _acceleration(self, time_ns: int, steps: int) -> Floats:
        """At the frames from the last one to the one before a stamp, (steps,), m/s²."""
        at_ns = self._last_ns + (time_ns - self._last_ns) * np.arange(steps) // steps
        return np.interp((at_ns - self._last_ns).astype(np.float64), (self._time_ns - self._last_ns), self._felt)


def _nearest(phase_rad: float, predicted_rad: float) -> float:
    return phase_rad + TURN * round((predicted_rad - phase_rad) / TURN)


def radar_channels(
    table: Table,
    calibration: RadarCalibration,
    info: RadarInfo,
    *,
    sensor: str,
    step_s: float,
    first: bool,
    bias_m_s2: float,
    **_: float,
) -> PrintedRadar:
    """A radar's sensor as printed, and its channel in the table, as `engine.channels.radar_channels`."""
    best, unit = calibration.best, printed_phase_per_m(info)
    item = FollowedTarget(best, unit, np.array([best.place_bin]), math.nan, 1.0 / info.frame_rate_hz)
    coasting_s, lost_s = ages(step_s)
    channel = Channel(
        sensor,
        Source.RADAR,
        unit / best.conversion_factor,
        zero_std_m=best.noise_m if first else np.inf,
        coasting_s=coasting_s,
        lost_s=lost_s,
        interval_s=step_s,
    )
    number = table.add(channel)
    table.scaled([number], calibration.relative_std)
    table.uncertain(ParameterKind.CLOCK_OFFSET, [number], clock_std_s(calibration.offset))
    return PrintedRadar(sensor, PrintedChain(item), number, bias_m_s2)
