"""The estimator with the predictions of `adaptive-kalman` as printed, which a paper's tracker is to work with.

The papers shift the region, reject matches and choose between phase and features by what their own filter predicts:
Ma, Choi and Sohn 2022, doi 10.1111/mice.12767, equations 27 to 29; Ma, Choi, Liu and Sohn 2022, doi
10.1016/j.autcon.2022.104338, equations 14 to 16.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.channels import interval_s
from midspan.fusion.blocks import VELOCITY_WITHIN, Rows
from midspan.fusion.estimator import Estimator, State
from midspan.fusion.model import EstimatorSettings
from midspan.fusion.streams import MethodSettings
from midspan.papers.printed.adaptive import PrintedFilter
from midspan.recording.point import figures
from midspan.recording.tracked import Side
from midspan.records import Acceleration, Displacement, Event, Measured, Samples


@dataclass(frozen=True, slots=True)
class StartOfPrinted:
    """The start of the printed filter: its settings, the samples' usual interval in s and the rms velocity in m/s."""

    settings: MethodSettings
    step_s: float
    speed_m_s: float


# Of the estimator, of the printed filter (None before the first sample), and the stamp of its first sample.
PredictedState = tuple[State, State | None, int]


class PredictedAsPrinted(Estimator):
    """The estimator as it is, except that along the main axis the printed filter predicts the measurements.

    It takes the first target that is seen at an instant, as the papers have one; all count from one zero, that of the
    first frame.
    """

    def __init__(self, settings: EstimatorSettings, start: StartOfPrinted, *, log: bool = False) -> None:
        super().__init__(settings, log=log)
        self._printed_start = start
        self._printed: PrintedFilter | None = None

    def push(self, record: Samples | Measured | Event) -> list[Rows]:
        """Take one block, as the estimator does."""
        if isinstance(record, Samples) and len(record.time_ns):
            if self._printed is None:
                self._printed = self._begun(int(record.time_ns[0]))
            self._printed.push(Acceleration(record.time_ns, record.value_m_s2[:, 0], record.noise_density[:, 0]))
        elif isinstance(record, Measured) and self._printed is not None:
            self._printed.wait(self._displacement(record))
        return super().push(record)

    def predict(self, channel: int, time_ns: int) -> tuple[float, float]:
        """Expected measurement of a channel at a time after the last sample, in its unit, and the variance of that."""
        known = self.settings.channels[channel]
        if known.axis or self._printed is None:
            return super().predict(channel, time_ns)
        if np.isnan(super().predict(channel, time_ns)[0]):
            # No samples come: holding the last one would lead away.
            return np.nan, np.inf
        value_m, variance_m2 = self._printed.predict(time_ns)
        return known.units_per_m * value_m, known.units_per_m**2 * variance_m2

    @property
    def state(self) -> PredictedState:  # type: ignore[override]
        """All that is remembered besides the log."""
        one = self._printed
        return super().state, None if one is None else one.state, 0 if one is None else one.origin_ns

    def restore(self, state: PredictedState) -> None:  # type: ignore[override]
        """Go on from a state of an estimator with the same settings."""
        estimator, printed, origin_ns = state
        super().restore(estimator)
        self._printed = None
        if printed is not None:
            self._printed = self._begun(origin_ns)
            self._printed.restore(printed)

    def _begun(self, origin_ns: int) -> PrintedFilter:
        start = self._printed_start
        return PrintedFilter(start.settings, origin_ns, step_s=start.step_s, speed_m_s=start.speed_m_s)

    def _displacement(self, record: Measured) -> Displacement:
        """The first measurement of each instant along the main axis that is finite, in m."""
        channels = self.settings.channels
        along = np.array([one.axis == 0 for one in channels])[record.channel]
        usable = np.flatnonzero(along & np.isfinite(record.value) & np.isfinite(record.variance))
        stamps, first = np.unique(record.time_ns[usable], return_index=True)
        taken = usable[first]
        units = np.array([one.units_per_m for one in channels])[record.channel[taken]]
        source = np.array([one.source for one in channels], dtype=np.uint8)[record.channel[taken]]
        return Displacement(stamps, record.value[taken] / units, record.variance[taken] / units**2, source)


def predicted_as_printed(settings: EstimatorSettings, printed: MethodSettings, main: Side, *, log: bool) -> Estimator:
    """The estimator of a recording's main axis, its printed filter begun by what is usual of the acceleration."""
    moved_m, omega = figures(main, main.prepared.rate_hz).motion
    kalman = replace(main.kalman, velocity_std=VELOCITY_WITHIN * omega * moved_m)
    step_s = interval_s(main.recording.acceleration.time_ns)
    start = StartOfPrinted(replace(printed, kalman=kalman), step_s, omega * moved_m)
    return PredictedAsPrinted(settings, start, log=log)
