"""The published rule of two cameras: the one with the larger mean number of matches measures, the other one does not.

J. Choi, Z. Ma, K. Kim, H. Sohn, "Continuous Structural Displacement Monitoring Using Accelerometer, Vision, and
Infrared (IR) Cameras", Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.2.2. Without this rule both measure,
each with its variance: numbers of matches of two cameras cannot be compared, variances in m² can.
"""

from dataclasses import dataclass, replace

from midspan.engine.twilight import Place, light_of_day
from midspan.records import NANOSECONDS, Event

# The mean is over this many seconds: the paper gives no length; 60 frames of its 30 Hz do not follow single ones.
AVERAGE_S = 2.0


@dataclass(frozen=True, slots=True)
class SwitchState:
    """What a `Switch` remembers: which camera measures, whether any has seen its target, and the last frames of each
    as (stamp in ns, matches).
    """

    chosen: int = 0
    begun: bool = False
    frames: tuple[tuple[tuple[int, float], ...], ...] = ((), ())


class Switch:
    """Takes the matches in each frame of two cameras, in the order of time, and tells which one measures."""

    def __init__(self, sensors: tuple[str, str], place: Place | None = None) -> None:
        """sensors: names of the cameras; the first one measures to begin with.

        place: where the first one alone measures by day and the second by night, and matches decide in between only.
        """
        self.sensors, self.place = sensors, place
        self.state = SwitchState()

    @property
    def chosen(self) -> str:
        """Name of the camera that measures."""
        return self.sensors[self.state.chosen]

    def push(self, sensor: str, time_ns: int, matches: float) -> Event | None:
        """Take a frame's matches (of trackers without matches the quality in percent; 0: lost); a switch is an event.

        Before any camera has seen its target there is nothing to switch from: the first that sees is chosen silently.
        """
        number, state = self.sensors.index(sensor), self.state
        since_ns = time_ns - round(AVERAGE_S * NANOSECONDS)
        frames = [tuple(frame for frame in own if frame[0] > since_ns) for own in state.frames]
        frames[number] = (*frames[number], (time_ns, matches))
        mine, theirs = (mean_matches(frames[k]) for k in (state.chosen, 1 - state.chosen))
        light = "transition" if self.place is None else light_of_day(time_ns, self.place)
        by_matches = 1 - state.chosen if theirs > mine else state.chosen
        chosen = {"day": 0, "night": 1}.get(light, by_matches)
        other = chosen != state.chosen
        begun = state.begun or max(mine, theirs) > 0.0
        self.state = replace(state, chosen=chosen, begun=begun, frames=tuple(frames))
        if not other or not state.begun:
            return None
        before, after = self.sensors[state.chosen], self.sensors[chosen]
        why = f"{theirs:.3g} matches beside {mine:.3g}" if light == "transition" else light
        return Event(time_ns, "switch", f"{before} → {after}: {why}")


def mean_matches(frames: tuple[tuple[int, float], ...]) -> float:
    """Mean number of matches of frames (stamp, matches); 0 where there are none."""
    return sum(matches for _, matches in frames) / max(len(frames), 1)
