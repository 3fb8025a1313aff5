"""A day of light: the sun's way, twilight, night, fog and rain, as long as is wanted; time 0 is noon."""

from dataclasses import dataclass

import numpy as np

from midspan.checks import positive, refuse
from midspan.records import Floats
from midspan.simulate.scene.scene import Image

Span = tuple[float, float]  # start and end in s


@dataclass(frozen=True, slots=True)
class Light:
    """The light that falls on a wall which faces south: towards the sun `right`, `down` and `out` of the wall (a unit
    vector), the strength of the sun's `beam` and that of the `sky`, both relative to the full sun.
    """

    right: float
    down: float
    out: float
    beam: float
    sky: float

    @property
    def mean(self) -> float:
        """What a smooth wall receives."""
        return self.beam * max(self.out, 0.0) + self.sky


@dataclass(frozen=True, slots=True)
class Sky:
    """24 hours of sun and weather that last `length_s`, from noon at time 0, again and again.

    latitude_deg, declination_deg: of the place and of the sun. `fog` and `rain` are spans in s; the fog comes and goes
    over `ramp_s` and takes so much contrast that exp(-fog_depth) of it are left. air_depth: optical depth of the air
    with the sun overhead; sky_share, night_light: light of the whole sky by day and by night relative to the full sun;
    it fades below an elevation of `fades_deg`, by ten every `tenth_deg`.
    """

    length_s: float = 86_400.0
    latitude_deg: float = 45.0
    declination_deg: float = 8.0
    fog: tuple[Span, ...] = ()
    fog_depth: float = 1.2
    rain: tuple[Span, ...] = ()
    ramp_s: float = 6.0
    air_depth: float = 0.14
    sky_share: float = 0.3
    fades_deg: float = 4.0
    tenth_deg: float = 4.0
    night_light: float = 1e-6

    def __post_init__(self) -> None:
        positive("length_s", self.length_s, "s")
        positive("ramp_s", self.ramp_s, "s")
        if not abs(self.latitude_deg) + abs(self.declination_deg) < 90.0:
            raise refuse("latitude_deg", "where the sun rises and sets each day", self.latitude_deg)

    def elevation_deg(self, time_s: float) -> float:
        """Elevation of the sun above the horizon, degrees."""
        return float(np.degrees(np.arcsin(self._toward_sun(time_s)[1])))

    def light(self, time_s: float) -> Light:
        """The light at `time_s`."""
        right, up, out = self._toward_sun(time_s)
        beam = float(np.exp(-self.air_depth / (up + 0.05))) if up > 0.0 else 0.0
        faded = min(0.0, (self.elevation_deg(time_s) - self.fades_deg) / self.tenth_deg)
        return Light(right, -up, out, beam, self.sky_share * 10.0**faded + self.night_light)

    def night(self, day: int = 0) -> Span:
        """Start and end (s) of the time with the sun below the horizon after noon number `day`."""
        tilt = np.tan(np.radians(self.latitude_deg)) * np.tan(np.radians(self.declination_deg))
        half = float(np.arccos(-tilt)) / (2 * np.pi) * self.length_s
        return day * self.length_s + half, (day + 1) * self.length_s - half

    def depth(self, time_s: float) -> float:
        """Optical depth of the fog at `time_s`, 0 without."""
        parts = [min(time_s - start, end - time_s) / self.ramp_s for start, end in self.fog if start < time_s < end]
        part = min(max(parts, default=0.0), 1.0)
        # A half cosine: fog has no kinks.
        return self.fog_depth * 0.5 * (1.0 - float(np.cos(np.pi * part)))

    def _toward_sun(self, time_s: float) -> tuple[float, float, float]:
        """The unit vector towards the sun: to the right on a wall that faces south (east), up, and out (south)."""
        hour = 2 * np.pi * time_s / self.length_s
        latitude, declination = np.radians(self.latitude_deg), np.radians(self.declination_deg)
        west = np.cos(declination) * np.sin(hour)
        south = np.sin(latitude) * np.cos(declination) * np.cos(hour) - np.cos(latitude) * np.sin(declination)
        up = np.cos(latitude) * np.cos(declination) * np.cos(hour) + np.sin(latitude) * np.sin(declination)
        return float(-west), float(np.clip(up, -1.0, 1.0)), float(south)


DRYING_S = 8.0  # a drop shrinks to nothing within this many seconds after the rain


class Drops:
    """Drops on a lens of `size_px` (rows, columns): they fall while it rains and dry afterwards, out of focus."""

    __slots__ = ("_end_s", "_place", "_radius_px", "_size_px", "_start_s")

    def __init__(
        self, size_px: tuple[int, int], rain: tuple[Span, ...], *, rng: np.random.Generator, count: int = 14
    ) -> None:
        self._size_px = size_px
        spans = np.array(rain, dtype=np.float64).reshape(-1, 2)
        start, end = np.repeat(spans, count, axis=0).T
        self._start_s: Floats = start + rng.uniform(0.0, 0.8, len(start)) * (end - start)
        self._end_s: Floats = end
        self._place = rng.uniform(0.0, 1.0, (len(start), 2)) * np.array(size_px)
        self._radius_px = rng.uniform(0.02, 0.06, len(start)) * float(np.hypot(*size_px))

    def cover(self, time_s: float) -> Image | None:
        """How much of each pixel (rows, columns) drops cover, 0 to 1; None without any."""
        dry = np.clip((time_s - self._end_s) / DRYING_S, 0.0, 1.0)
        there = np.flatnonzero((time_s >= self._start_s) & (dry < 1.0))
        if not len(there):
            return None
        rows, columns = (np.arange(size, dtype=np.float32) for size in self._size_px)
        clear = np.ones(self._size_px, dtype=np.float32)
        for k in there:
            radius = self._radius_px[k] * (1.0 - dry[k])
            away = np.hypot(rows[:, None] - self._place[k, 0], columns[None, :] - self._place[k, 1])
            # A drop on the lens is far out of focus: its border is a quarter of it wide.
            clear *= np.clip((away - 0.75 * radius) / (0.5 * radius + 0.5), 0.0, 1.0)
        covered: Image = np.float32(1.0) - clear
        return covered


@dataclass(frozen=True, slots=True)
class Headlights:
    """Cars at night, their lamps in row `row_px`, that pass from left to right in `crossing_s` from each of `starts_s`.

    Lamps dazzle `lamp_px` around them, and throw light of `strength` (relative to the full sun) on `reach_px` of the
    wall.
    """

    starts_s: tuple[float, ...] = ()
    row_px: float = 150.0
    crossing_s: float = 3.0
    apart_px: float = 14.0
    lamp_px: float = 2.5
    reach_px: float = 45.0
    strength: float = 0.08

    def lights(self, size_px: tuple[int, int], time_s: float) -> tuple[Image, Image] | None:
        """Light thrown on the wall and light into the lens (rows, columns), relative to the full sun; None without a
        car.
        """
        since = next((time_s - s for s in self.starts_s if 0.0 <= time_s - s < self.crossing_s), None)
        if since is None:
            return None
        place = since / self.crossing_s
        centre = (size_px[1] + 2 * self.reach_px) * place - self.reach_px
        thrown = self.strength * _spot(size_px, (self.row_px - 0.6 * self.reach_px, centre), self.reach_px)
        lamps = [(self.row_px, centre + side * self.apart_px / 2) for side in (-1.0, 1.0)]
        return thrown, sum((_spot(size_px, lamp, self.lamp_px) for lamp in lamps), np.zeros(size_px, dtype=np.float32))


def _spot(size_px: tuple[int, int], centre: tuple[float, float], std_px: float) -> Image:
    """A Gaussian spot (rows, columns) of height 1 about `centre` (row, column)."""
    down, across = (
        np.exp(-0.5 * ((np.arange(size) - middle) / std_px) ** 2).astype(np.float32)
        for size, middle in zip(size_px, centre, strict=True)
    )
    spot: Image = down[:, None] * across[None, :]
    return spot
