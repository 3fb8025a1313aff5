"""A recording as a loop over its point's `push`: all records in, everything that came out of them back."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from midspan.engine.point import ACCELEROMETER, Output, Point
from midspan.engine.sensors import Seen
from midspan.fusion.estimator import Rows
from midspan.recording.cameras.tracked import Eye, Side
from midspan.records import NANOSECONDS, Arrival, Estimate, Event, Innovation, Measured, Readings, Tracked, joined


@dataclass(slots=True)
class Outcome:
    """What a point gave for a recording: rows, what each sensor measured, events."""

    rows: list[Rows] = field(default_factory=list)
    measured: dict[str, list[Measured]] = field(default_factory=dict)
    sensor_events: list[Event] = field(default_factory=list)

    def take(self, outputs: Sequence[Output]) -> None:
        """Keep what a push gave."""
        for output in outputs:
            if isinstance(output, Rows):
                self.rows.append(output)
            elif isinstance(output, Event):
                self.sensor_events.append(output)
            elif isinstance(output, Seen):
                self.sensor_events += output.events
                if output.measured is not None:
                    self.measured.setdefault(output.sensor, []).append(output.measured)

    def estimate(self, axis: int) -> Estimate:
        """The rows of an axis as one block."""
        return joined([rows.estimates[axis] for rows in self.rows if rows.estimates])

    @property
    def fusion_events(self) -> tuple[Event, ...]:
        """What the estimator decided that is worth an event."""
        return tuple(event for rows in self.rows for event in rows.events)

    def measured_by(self, sensor: str) -> Measured:
        """All that a sensor measured as one block."""
        return joined(self.measured[sensor])

    @property
    def zero_variance_m2(self) -> tuple[float, ...]:
        """Variance of the zero of each axis at the end."""
        return next((rows.zero_variance_m2 for rows in reversed(self.rows) if rows.zero_variance_m2), (0.0, 0.0))

    def innovation(self, channel: int) -> Innovation:
        """The innovations of a channel as one block."""
        return joined([rows.innovations[channel] for rows in self.rows if rows.innovations])


def run(point: Point, sides: Sequence[Side], eyes: Sequence[Eye]) -> Outcome:
    """Push all records of a recording into its point."""
    outcome = Outcome()
    time_ns = sides[0].recording.acceleration.time_ns
    value = np.column_stack([side.recording.acceleration.value for side in sides if side.recording.fused])
    outcome.take(point.push(Arrival(ACCELEROMETER, 0, Readings(time_ns, value))))
    if "displacement" in point.sensors:
        series = sides[0].recording.displacement
        outcome.take(point.push(Arrival("displacement", 0, Readings(series.time_ns, series.value[:, None]))))
    named = {eye.sensor: eye for eye in eyes}
    counts = dict.fromkeys(named, 0)
    for eye in eyes:
        for k in range(eye.tracking.done):
            stamp = int(eye.tracking.time_ns[k])
            record = Tracked(stamp, stamp, tuple(target.translation(k) for target in eye.tracking.targets))
            outcome.take(point.push(Arrival(eye.sensor, k, record)))
        counts[eye.sensor] = eye.tracking.done
    while (following := next_camera(eyes, counts)) is not None:
        eye, frame = following, following.tracking.take()
        if frame is None:
            eye.tracking.ended = True
            continue
        outputs = point.push(Arrival(eye.sensor, counts[eye.sensor], frame))
        counts[eye.sensor] += 1
        for output in outputs:
            if isinstance(output, Seen) and output.translations:
                seen = named[output.sensor]
                early_ns = -late_ns(seen)
                seen.tracking.keep([replace(one, time_ns=one.time_ns + early_ns) for one in output.translations])
        outcome.take(outputs)
    outcome.take(point.finish())
    return outcome


def late_ns(eye: Eye) -> int:
    """What is added to a camera's stamps to get the accelerometer's clock."""
    return round(NANOSECONDS * eye.calibrations[0].offset.value_s)


def next_camera(eyes: Sequence[Eye], counts: dict[str, int]) -> Eye | None:
    """The camera with the earliest frame that has not been pushed, on one clock; None at the end."""
    due = [
        (int(eye.tracking.time_ns[counts[eye.sensor]]) + late_ns(eye), number)
        for number, eye in enumerate(eyes)
        if not eye.tracking.ended and counts[eye.sensor] < len(eye.tracking.time_ns)
    ]
    return eyes[min(due)[1]] if due else None
