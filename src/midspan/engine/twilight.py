"""Day, night and the time between, by the sun over a place: which of two cameras the published rule lets measure.

J. Choi, Z. Ma, K. Kim, H. Sohn, Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.2.2: vision by day, infrared
by night, and the one with more matches within about an hour of the beginning of morning nautical twilight and of the
end of evening nautical twilight.
"""

from dataclasses import dataclass

import numpy as np

from midspan.records import NANOSECONDS
from midspan.signals.stamps import EPOCH_FROM_NS

# The sun's elevation, degrees, at which nautical twilight begins and ends, and s before and after it.
NAUTICAL_DEG, TRANSITION_S = -12.0, 3600.0
_J2000_NS, _DAY_NS = 946_728_000 * NANOSECONDS, 86_400 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class Place:
    """A place on Earth: degrees, north and east positive."""

    latitude_deg: float
    longitude_deg: float


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
