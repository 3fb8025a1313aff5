"""Tracks of an exact pinhole camera that moves and turns with a structure, and the recording that they are part of.

Axes: x right, y down, z along the view. From the place t with the rotation R a point P is seen at f times the first two
of Rᵀ (P − t) over the third. Nothing here comes from the package, so that it cannot share a mistake with it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

GRAVITY_M_S2 = 9.80665
FOCAL_PX, ROWS = 5000.0, 2000
MDEG = np.radians(1e-3)

Course = Callable[..., np.ndarray]


def waves(low_hz: float, high_hz: float, rms: float, seed: int, count: int = 12) -> Course:
    """A sum of sines even over a band, as a function of times (n,) and the order of its derivative."""
    rng = np.random.default_rng(seed)
    hertz = low_hz + (high_hz - low_hz) * (np.arange(count) + rng.uniform(0.0, 1.0, count)) / count
    omega, phase = 2.0 * np.pi * hertz, rng.uniform(0.0, 2.0 * np.pi, count)
    size = rms * np.sqrt(2.0 / count)
    return lambda t, order=0: np.sin(np.multiply.outer(t, omega) + phase + 0.5 * np.pi * order) @ (size * omega**order)


def together(*courses: Course) -> Course:
    """The sum of courses."""
    return lambda t, order=0: sum(one(t, order) for one in courses)


def times(course: Course, factor: float) -> Course:
    """A course times a number."""
    return lambda t, order=0: factor * course(t, order)


def nothing(t: np.ndarray, order: int = 0) -> np.ndarray:
    """Rest."""
    return np.zeros_like(t)


# A footbridge: modes, and what people sink it by; its box leans with it, and nods and warms on its bracket.
MODES = waves(2.0, 2.2, 1.0e-3, 1)
WALKERS = waves(0.02, 0.15, 0.7e-3, 2)
MOTION = together(MODES, WALKERS)
NODS, SUN = waves(3.3, 3.7, 1.5 * MDEG, 3), waves(0.01, 0.04, 4.0 * MDEG, 4)
TILT = together(NODS, SUN, times(MOTION, np.pi / 45.0))


@dataclass(frozen=True)
class Target:
    """A target: its distance (m), where it is seen at rest from the optical axis (px), and what it moves by itself."""

    distance_m: float
    x_px: float = 0.0
    y_px: float = 0.0
    own_m: Course = nothing


def stacked(*distances_m: float, apart_px: float = 150.0) -> tuple[Target, ...]:
    """Targets one below the other in the picture."""
    middle = 0.5 * (len(distances_m) - 1)
    return tuple(Target(one, 0.0, apart_px * (k - middle)) for k, one in enumerate(distances_m))


@dataclass(frozen=True)
class Site:
    """What a box on a structure measures: the structure's motion upwards or, where lateral, to the picture's top.

    turns: about x (positive: the picture goes down), y and z, rad; roll_deg: how far the camera is mounted askew;
    readout_s: from the picture's first row to its last. lateral: gravity acts along the view and the measured axis is
    level, so that its accelerometer feels a turn about x: of a camera that looks up (1) or down (-1); 0: upright axis.
    """

    targets: tuple[Target, ...] = field(default_factory=lambda: stacked(3.0, 10.0))
    motion: Course = MOTION
    turns: tuple[Course, Course, Course] = (TILT, nothing, nothing)
    rate_hz: float = 10.0
    noise_px: float = 0.005
    noise_m_s2: float = 1e-3
    roll_deg: float = 0.0
    readout_s: float = 0.0
    lateral: int = 0
    duration_s: float = 60.0
    seed: int = 0

    @property
    def met_s(self) -> np.ndarray:
        """The frames' stamps, s."""
        return np.arange(1.0, self.duration_s - 0.5, 1.0 / self.rate_hz)

    def pixels(self, target: Target) -> np.ndarray:
        """Where a target is seen (n, 2), px."""
        t = self.met_s + self.readout_s * (target.y_px / ROWS + 0.5)
        none = np.zeros_like(t)
        place = np.stack((none, -self.motion(t), none), axis=-1)
        mounted = rotation(np.array([[0.0, 0.0, np.radians(self.roll_deg)]]))
        turned = rotation(np.stack([turn(t) for turn in self.turns], axis=-1)) @ mounted
        away = target.distance_m * np.array([target.x_px / FOCAL_PX, target.y_px / FOCAL_PX, 1.0])
        point = (mounted[0] @ away) + np.stack((none, -target.own_m(t), none), axis=-1)
        seen = np.einsum("nji,nj->ni", turned, point - place)
        return FOCAL_PX * seen[:, :2] / seen[:, 2:]

    def write(self, folder: Path, more: str = "") -> Path:
        """The recording; more: further lines of recording.toml."""
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(self.seed)
        at = np.arange(0.0, self.duration_s, 0.01)
        felt = (
            self.motion(at, 2)
            - self.lateral * GRAVITY_M_S2 * self.turns[0](at)
            + rng.normal(0.0, self.noise_m_s2, len(at))
        )
        columns = {"time_s": self.met_s}
        for k, target in enumerate(self.targets):
            end = "" if k == 0 else f"_target{k + 1}"
            px = self.pixels(target) + rng.normal(0.0, self.noise_px, (len(self.met_s), 2))
            columns |= {f"x_px{end}": px[:, 0] - px[0, 0], f"y_px{end}": px[:, 1] - px[0, 1]}
        table(folder / "accel.csv", {"time_s": at, "accel": felt + 0.02})
        table(folder / "track.csv", columns)
        (folder / "recording.toml").write_text(
            '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "track.csv"\ndirection = "y"\n'
            + more
        )
        return folder

    def declared(self, *distances_m: float | str, names: tuple[str, ...] = ()) -> str:
        """Sections of the targets with distances as somebody declares them."""
        names = names or ("1", *(f"target{k + 2}" for k in range(len(self.targets) - 1)))
        given = [f'"{one}"' if isinstance(one, str) else repr(one) for one in distances_m]
        return "".join(
            f'[[camera.target]]\nname = "{name}"\nroi = [0, {60 * k}, 48, 48]\ndistance_m = {one}\n'
            for k, (name, one) in enumerate(zip(names, given, strict=True))
        )

    def error_mm(self, time_s: np.ndarray, displacement_mm: np.ndarray, late_s: float = 0.0) -> np.ndarray:
        """What a displacement is off by, counted from the first frame; late_s: of its clock, as calibrated."""
        return displacement_mm - 1e3 * (self.motion(time_s) - self.motion(self.met_s[:1] + late_s))

    def but(self, **changes: object) -> "Site":
        """The same with other values."""
        return replace(self, **changes)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


def table(file: Path, columns: dict[str, np.ndarray]) -> None:
    """Writes columns (n,) as a table."""
    np.savetxt(file, np.column_stack(list(columns.values())), "%.7f", ",", header=",".join(columns), comments="")
