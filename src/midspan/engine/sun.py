"""How high the sun stands: day, dusk and night from a place and an instant."""

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds

# 2000-01-01 12:00 UTC, the epoch that the sun's elements count from, as seconds since 1970.
_J2000_S = 946_728_000
_DAY_S = 86_400.0


def sun_elevation_deg(time_ns: Nanoseconds, latitude_deg: float, longitude_deg: float) -> Floats:
    """Elevation (n,) of the sun's middle above the horizon in degrees, without refraction, to about 0.05°.

    time_ns (n,): since 1970, UTC. latitude_deg: north positive, -90 to 90; longitude_deg: east positive, -180 to 180.
    The sun's place is that of a body on Kepler's ellipse around the earth, its equation of the centre to second order
    in the eccentricity; the elements are linear in time, good from 1950 to 2050: J. J. Michalsky, "The Astronomical
    Almanac's algorithm for approximate solar position (1950-2050)", Solar Energy 40 (1988) 227-235, doi
    10.1016/0038-092X(88)90045-X.
    """
    days = (np.asarray(time_ns, dtype=np.int64) / NANOSECONDS - _J2000_S) / _DAY_S
    mean_longitude = np.radians(280.460 + 0.9856474 * days)
    anomaly = np.radians(357.528 + 0.9856003 * days)
    eccentricity = 0.01671
    centre = 2.0 * eccentricity * np.sin(anomaly) + 1.25 * eccentricity**2 * np.sin(2.0 * anomaly)
    longitude = mean_longitude + centre
    tilt = np.radians(23.439 - 3.56e-7 * days)
    declination = np.arcsin(np.sin(tilt) * np.sin(longitude))
    ascension = np.arctan2(np.cos(tilt) * np.sin(longitude), np.cos(longitude))
    # Sidereal time at Greenwich, as an angle.
    sidereal = np.radians(280.46062 + 360.98564737 * days)
    hour = sidereal + np.radians(longitude_deg) - ascension
    latitude = np.radians(latitude_deg)
    height = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour)
    return np.asarray(np.degrees(np.arcsin(np.clip(height, -1.0, 1.0))), dtype=np.float64)
