"""The published rule of two cameras: the one with the larger mean number of matches measures, the other one does not.

J. Choi, Z. Ma, K. Kim, H. Sohn, "Continuous Structural Displacement Monitoring Using Accelerometer, Vision, and
Infrared (IR) Cameras", Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.2.2. Without this rule both measure,
each with its variance: numbers of matches of two cameras cannot be compared, variances in m² can. By day and night the
sun over a place decides: vision by day, infrared by night, and the one with more matches within about an hour of the
beginning of morning nautical twilight and of the end of evening nautical twilight.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.sensors import Seen
from midspan.recording.streams.recording import Recording
from midspan.recording.tracked import TrackedCamera
from midspan.records import NANOSECONDS, Event, PixelTranslation
from midspan.signals.stamps import EPOCH_FROM_NS

# The mean is over this many seconds: the paper gives no length; 60 frames of its 30 Hz do not follow single ones.
AVERAGE_S = 2.0
# The sun's elevation, degrees, at which nautical twilight begins and ends, and s before and after it.
NAUTICAL_DEG, TRANSITION_S = -12.0, 3600.0
_J2000_NS, _DAY_NS = 946_728_000 * NANOSECONDS, 86_400 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Place:
    """A place on Earth: degrees, north and east positive."""

    latitude_deg: float
    longitude_deg: float


# Which camera measures, whether any has seen its target, and the last frames of each as (stamp in ns, matches).
SwitchState = tuple[int, bool, tuple[tuple[tuple[int, float], ...], ...]]


class Switch:
    """Takes the matches in each frame of two cameras, in the order of time, and tells which one measures."""

    def __init__(self, sensors: tuple[str, str], place: Place | None = None) -> None:
        """sensors: names of the cameras; the first one measures to begin with.

        place: where the first one alone measures by day and the second by night, and matches decide in between only.
        """
        self.sensors, self.place = sensors, place
        self.state: SwitchState = (0, False, ((), ()))

    @property
    def chosen(self) -> str:
        """Name of the camera that measures."""
        return self.sensors[self.state[0]]

    def switched(self, seen: Seen) -> Seen:
        """What a sensor saw, without measurements where the other camera measures; a switch is among its events."""
        if seen.sensor not in self.sensors:
            return seen
        found = [one for one in seen.found if isinstance(one, PixelTranslation)]
        reported = self.push(seen.sensor, found[0].time_ns, max(one.strength for one in found))
        measured = seen.measured if seen.sensor == self.chosen else None
        return replace(seen, measured=measured, events=seen.events if reported is None else (*seen.events, reported))

    def push(self, sensor: str, time_ns: int, matches: float) -> Event | None:
        """Take a frame's matches (of trackers without matches the quality in percent; 0: lost); a switch is an event.

        Before any camera has seen its target there is nothing to switch from: the first that sees is chosen silently.
        """
        number, (before, begun, known) = self.sensors.index(sensor), self.state
        since_ns = time_ns - round(AVERAGE_S * NANOSECONDS)
        frames = [tuple(frame for frame in own if frame[0] > since_ns) for own in known]
        frames[number] = (*frames[number], (time_ns, matches))
        mine, theirs = (mean_matches(frames[k]) for k in (before, 1 - before))
        light = "transition" if self.place is None else light_of_day(time_ns, self.place)
        by_matches = 1 - before if theirs > mine else before
        chosen = {"day": 0, "night": 1}.get(light, by_matches)
        self.state = chosen, begun or max(mine, theirs) > 0.0, tuple(frames)
        if chosen == before or not begun:
            return None
        why = f"{theirs:.3g} matches next to {mine:.3g}" if light == "transition" else light
        return Event(time_ns, "switch", f"{self.sensors[before]} → {self.sensors[chosen]}: {why}")


def mean_matches(frames: tuple[tuple[int, float], ...]) -> float:
    """Mean number of matches of frames (stamp, matches); 0 where there are none."""
    return sum(matches for _, matches in frames) / max(len(frames), 1)


def sun_elevation_deg(time_ns: int, place: Place) -> float:
    """The sun's elevation at an instant of UTC, ns since 1970, without refraction; within 0.02° from 1950 to 2050.

    The low-precision formulas of the Astronomical Almanac (page C5).
    """
    days = (time_ns - _J2000_NS) / _DAY_NS
    anomaly = np.radians(357.528 + 0.9856003 * days)
    ecliptic = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    obliquity = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(obliquity) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(obliquity) * np.sin(ecliptic))
    sidereal = np.radians(15.0 * (18.697374558 + 24.06570982441908 * days) + place.longitude_deg)
    latitude = np.radians(place.latitude_deg)
    up = np.sin(latitude) * np.sin(declination)
    up += np.cos(latitude) * np.cos(declination) * np.cos(sidereal - ascension)
    return float(np.degrees(np.arcsin(np.clip(up, -1.0, 1.0))))


def light_of_day(time_ns: int, place: Place) -> str:
    """The time of day: "day", "night", or "transition" within an hour of nautical twilight's dark end.

    "transition" too where stamps are no dates.
    """
    if time_ns < EPOCH_FROM_NS:
        return "transition"
    hour_ns = round(TRANSITION_S * NANOSECONDS)
    around = [sun_elevation_deg(time_ns + step, place) > NAUTICAL_DEG for step in (-hour_ns, 0, hour_ns)]
    return "day" if all(around) else "transition" if any(around) else "night"


def switch_of(recording: Recording, tracked_cameras: Sequence[TrackedCamera]) -> Switch:
    """The rule for the first two cameras of a recording; as printed, day and night decide between vision and infrared
    where the site is known.
    """
    site, kinds = recording.settings.site, [tracked_camera.view.kind for tracked_camera in tracked_cameras[:2]]
    sensors = (tracked_cameras[0].sensor, tracked_cameras[1].sensor)
    if site is None or not recording.settings.fusion.literal or kinds != ["camera", "infrared"]:
        return Switch(sensors)
    return Switch(sensors, Place(site.latitude_deg, site.longitude_deg))
