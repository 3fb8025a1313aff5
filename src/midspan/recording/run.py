"""A recording as a loop over its point's `push`: all records in, everything that came out of them back."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from midspan.engine.point import ACCELEROMETER, Output, Point
from midspan.engine.sensors import Seen, Tracked
from midspan.fusion.estimator import Rows
from midspan.recording.cameras.tracked import Eye, Side
from midspan.records import NANOSECONDS, Arrival, Estimate, Event, Innovation, Readings, joined


@dataclass(slots=True)
class Outcome:
    """What a point gave for a recording: rows of each axis, innovations of each channel, events."""

    rows: list[Rows] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def take(self, outputs: Sequence[Output]) -> None:
        """Keep what a push gave."""
        for output in outputs:
            if isinstance(output, Rows):
                self.rows.append(output)
                self.events += output.events
            elif isinstance(output, Event):
                self.events.append(output)
            elif isinstance(output, Seen):
                self.events += output.events

    def estimate(self, axis: int) -> Estimate:
        """The rows of an axis as one block."""
        return joined([rows.estimates[axis] for rows in self.rows if rows.estimates])

    def innovation(self, channel: int) -> Innovation:
        """The innovations of a channel as one block."""
        return joined([rows.innovations[channel] for rows in self.rows if rows.innovations])


def run(point: Point, sides: Sequence[Side], eyes: Sequence[Eye]) -> Outcome:
    """Push all records of a recording into its point."""
    outcome = Outcome()
    time_ns = sides[0].recording.acceleration.time_ns
    value = np.column_stack([side.recording.acceleration.value for side in sides])
    outcome.take(point.push(Arrival(ACCELEROMETER, 0, Readings(time_ns, value))))
    counts = [0] * len(eyes)
    for number, eye in enumerate(eyes):
        for k in range(eye.tracking.done):
            record = Tracked(int(eye.tracking.time_ns[k]), eye.tracking.translations(k))
            outcome.take(point.push(Arrival(eye.sensor, counts[number], record)))
            counts[number] += 1
    while (number := next_camera(eyes)) is not None:
        eye = eyes[number]
        frame = eye.tracking.take()
        if frame is None:
            eye.tracking.ended = True
            continue
        outputs = point.push(Arrival(eye.sensor, counts[number], frame))
        counts[number] += 1
        for output in outputs:
            if isinstance(output, Seen):
                eyes_by_name = {one.sensor: one for one in eyes}
                eyes_by_name[output.sensor].tracking.keep(output.translations)
        outcome.take(outputs)
    outcome.take(point.finish())
    return outcome


def next_camera(eyes: Sequence[Eye]) -> int | None:
    """Number of the camera with the earliest frame that has not been tracked, on one clock; None at the end."""
    due = []
    for number, eye in enumerate(eyes):
        tracking = eye.tracking
        if not tracking.ended and tracking.done < len(tracking.time_ns):
            late_ns = round(NANOSECONDS * eye.calibrations[0].offset.value_s)
            due.append((int(tracking.time_ns[tracking.done]) + late_ns, number))
    return min(due)[1] if due else None
