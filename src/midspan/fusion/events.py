"""What the gate did that is worth telling: jumps that were taken over, and runs of rejected measurements."""

import numpy as np

from midspan.fusion.gate import LEAST_REJECTIONS, REACQUIRED, REJECTED
from midspan.records import NANOSECONDS, Event, Innovation


class GateEvents:
    """Follows the verdicts of a stream; a run of rejections may go on from block to block."""

    def __init__(self) -> None:
        self._first_ns = self._last_ns = self._count = 0
        self._first_m = 0.0

    def push(self, innovation: Innovation) -> list[Event]:
        """Events that the verdicts of the next measurements complete, in time order."""
        rejected = innovation.verdict == REJECTED
        after = np.concatenate(([self._count > 0], rejected))[: len(rejected)]
        events = []
        for i in np.flatnonzero(rejected | after | (innovation.verdict == REACQUIRED)):
            time_ns = int(innovation.time_ns[i])
            if rejected[i]:
                if not self._count:
                    self._first_ns, self._first_m = time_ns, float(innovation.value_m[i])
                self._last_ns, self._count = time_ns, self._count + 1
                continue
            if innovation.verdict[i] == REACQUIRED:
                last_m = float(innovation.value_m[i])
                jumps = (self._first_m if self._count else last_m, last_m)
                events.append(_reacquired(time_ns, self._count + 1, jumps))
            elif self._count >= LEAST_REJECTIONS:
                events.append(self._rejected())
            self._count = 0
        return events

    def finish(self) -> list[Event]:
        """The run that the end of the record cut off, if there is one."""
        events = [self._rejected()] if self._count >= LEAST_REJECTIONS else []
        self._count = 0
        return events

    def _rejected(self) -> Event:
        first, last = self._first_ns / NANOSECONDS, self._last_ns / NANOSECONDS
        return Event(
            self._first_ns,
            "rejected",
            f"{self._count} measurements in a row were rejected from {first:.3f} to {last:.3f} s: they contradict the "
            "acceleration. Something may have stood in front of the target, or the tracker held on to something else.",
        )


def gate_events(innovation: Innovation) -> list[Event]:
    """The events of a whole record."""
    watch = GateEvents()
    return [*watch.push(innovation), *watch.finish()]


def _reacquired(time_ns: int, count: int, jumps_m: tuple[float, float]) -> Event:
    return Event(
        time_ns,
        "reacquired",
        f"The measured displacement had left the prediction, by {1e3 * jumps_m[0]:.2f} mm at first and "
        f"{1e3 * jumps_m[1]:.2f} mm at last, for {count} measurements in a row; its new level was taken over. Check "
        "whether the target or the sensor has moved.",
    )
