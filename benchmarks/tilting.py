"""A box that tilts, on a footbridge and a tower: two targets at two distances, and one alone; what the look costs.

Tracks of an exact pinhole, written here from closed forms; --quick: one draw of each row.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np

import midspan
from benchmarks.table import goal, show
from midspan.records import Floats

FOCAL_PX, DURATION_S, LATE_S, APART_PX = 5000.0, 100.0, 0.114, 150.0
MDEG, SLOPE, HEIGHT_M, GRAVITY = float(np.radians(1e-3)), float(np.pi / 45.0), 60.0, 9.81
# Of the camera: noise of a frame, px, and frames a second.
GOOD, USUAL = (0.003, 30.0), (0.01, 10.0)
# Distances (m), camera, method, and the largest error (mm) without that of the zero; bounds are two to three quarters.
ROWS = (
    ((3.0, 10.0), GOOD, "smoother", 0.002),
    ((3.0, 10.0), USUAL, "smoother", 0.007),
    ((10.0, 63.0), GOOD, "smoother", 0.004),
    ((10.0, 63.0), USUAL, "smoother", 0.015),
    ((3.0, 10.0), GOOD, "kalman", 0.004),
    ((3.0, 10.0), USUAL, "kalman", 0.014),
)
# The same on a tower's top, looking down at its side and foot; nothing of it is declared.
TOWER_ROWS = (((20.0, 60.0), GOOD, "smoother", 0.1), ((20.0, 60.0), USUAL, "smoother", 0.1))
ALONE = (((3.0,), GOOD), ((3.0,), USUAL), ((10.0,), GOOD), ((10.0,), USUAL))
INSIDE, ALONE_INSIDE, MAX_COST, TIMES = 0.93, 0.9, 1.3, 3

Course = Callable[..., Floats]


def waves(rng: np.random.Generator, low_hz: float, high_hz: float, rms: float, count: int = 20) -> Course:
    """A sum of sines even over a band, by times (n,) and order of the derivative."""
    omega = 2.0 * np.pi * (low_hz + (high_hz - low_hz) * (np.arange(count) + rng.uniform(size=count)) / count)
    phase, size = rng.uniform(0.0, 2.0 * np.pi, count), rms * np.sqrt(2.0 / count)
    return lambda t, order=0: np.sin(np.multiply.outer(t, omega) + phase + 0.5 * np.pi * order) @ (size * omega**order)


def walker(at_s: float, deep_m: float = 2e-3, spread_s: float = 5.5) -> Course:
    """What somebody sinks the bridge by who passes at `at_s`; of order 0 and 2."""

    def course(t: Floats, order: int = 0) -> Floats:
        z = (np.asarray(t) - at_s) / spread_s
        bell = -deep_m * np.exp(-0.5 * z * z)
        return bell if order == 0 else bell * (z * z - 1.0) / spread_s**2

    return course


class Box:
    """A box at quarter span: it moves, leans with the bridge, later under walkers, nods and warms on its bracket."""

    def __init__(self, seed: int, *, tilts: bool = True) -> None:
        rng = np.random.default_rng(seed)
        self.rng = rng
        parts = [waves(rng, 2.05, 2.15, 1e-3), waves(rng, 5.9, 6.1, 0.05e-3)]
        parts += [walker(at + rng.uniform(-4.0, 4.0)) for at in (20.0, 50.0, 80.0)]
        nods, sun = waves(rng, 3.3, 3.7, 1.5 * MDEG), waves(rng, 0.004, 0.02, 4.0 * MDEG, 6)
        self.moved_m = lambda t, order=0: sum(one(t, order) for one in parts)
        lean = lambda t: SLOPE * (0.6 * self.moved_m(t) + 0.4 * self.moved_m(t - 2.0))  # noqa: E731
        self.tilt = (lambda t: lean(t) + nods(t) + sun(t)) if tilts else np.zeros_like

    def felt(self, t: Floats) -> Floats:
        """What the accelerometer reads, m/s²."""
        return self.moved_m(t, 2) + GRAVITY

    def seen_px(self, distance_m: float, y_px: float, at_s: Floats) -> Floats:
        """Where a target is seen, px below the optical axis."""
        below, angle = y_px * distance_m / FOCAL_PX + self.moved_m(at_s), self.tilt(at_s)
        down = np.cos(angle) * below + np.sin(angle) * distance_m
        return FOCAL_PX * down / (np.cos(angle) * distance_m - np.sin(angle) * below)

    def write(self, folder: Path, distances_m: tuple[float, ...], noise_px: float, rate_hz: float) -> Path:
        """The recording of targets one below the other."""
        folder.mkdir()
        at, met = np.arange(0.0, DURATION_S, 0.01), np.arange(0.5, DURATION_S - 0.5, 1.0 / rate_hz)
        felt = self.felt(at) + self.rng.normal(0.0, 1e-3, len(at))
        columns = {"time_s": met - LATE_S}
        for k, distance_m in enumerate(distances_m):
            end = "" if k == 0 else f"_target{k + 1}"
            px = self.seen_px(distance_m, APART_PX * (k - 0.5), met) + self.rng.normal(0.0, noise_px, len(met))
            columns |= {f"x_px{end}": self.rng.normal(0.0, noise_px, len(met)), f"y_px{end}": px - px[0]}
        for name, table in (("accel", {"time_s": at, "accel": felt}), ("track", columns)):
            values, head = np.column_stack(list(table.values())), ",".join(table)
            np.savetxt(folder / f"{name}.csv", values, "%.7f", ",", header=head, comments="")
        (folder / "recording.toml").write_text(
            '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "track.csv"\ndirection = "y"\n'
        )
        return folder


class Top(Box):
    """A box on a tower's top that looks down: each mode leans by its own slope, the sun besides."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.rng = rng
        modes = (waves(rng, 0.24, 0.26, 8e-3), waves(rng, 1.48, 1.52, 0.3e-3), waves(rng, 0.003, 0.02, 5e-3, 8))
        slopes, sun = (1.377 / HEIGHT_M, -4.78 / HEIGHT_M, 1.333 / HEIGHT_M), waves(rng, 0.004, 0.02, 3.0 * MDEG, 6)
        self.moved_m = lambda t, order=0: sum(one(t, order) for one in modes)
        # The view turns the other way.
        self.tilt = lambda t: -sum(k * one(t) for k, one in zip(slopes, modes, strict=True)) - sun(t)

    def felt(self, t: Floats) -> Floats:
        """What the accelerometer reads, m/s²."""
        return np.asarray(self.moved_m(t, 2) * np.cos(self.tilt(t)) + GRAVITY * np.sin(self.tilt(t)))


def scored(box: Box, folder: Path, method: str) -> tuple[float, float, float]:
    """Error without its mean (mm rms), the band's own, and the share inside; after 5 s, as a filter needs."""
    result = midspan.estimate(folder, method=method)
    late = result.time_s > 5.0
    error = (result.displacement_mm - 1e3 * box.moved_m(result.time_s))[late]
    error -= np.mean(error)
    own = np.sqrt(np.maximum(result.displacement_std_mm[late] ** 2 - (1e3 * result.zero_std_m) ** 2, 0.0))
    return float(np.std(error)), float(np.median(own)), float(np.mean(np.abs(error) < 1.96 * own))


def main() -> None:
    """The table of two targets and of one, with goals; and what the look for a tilt costs where there is none."""
    seeds = (1,) if "--quick" in sys.argv else (1, 2)
    lines, verdicts = [], []
    rows = [(Box, row) for row in ROWS] + [(Top, row) for row in TOWER_ROWS]
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for kind, (distances, (noise_px, rate), method, limit) in rows:
            what = f"{' + '.join(f'{one:g}' for one in distances)} m, {noise_px:g} px, {rate:g}/s, {method}"
            found = []
            for seed in seeds:
                box = kind(seed)
                folder = box.write(root / f"{what} {seed}".replace("/", " a "), distances, noise_px, rate)
                found.append(scored(box, folder, method))
            rms, own, share = np.mean(found, axis=0)
            lines.append((what, float(rms), float(own), f"{100.0 * share:.1f} %", limit))
            verdicts += [(what, float(rms), limit, "mm", False), (what, float(share), INSIDE, "inside", True)]
        for distances, (noise_px, rate) in ALONE:
            what = f"{distances[0]:g} m alone, {noise_px:g} px, {rate:g}/s, smoother"
            for seed in seeds:
                box = Box(seed)
                folder = box.write(root / f"{what} {seed}".replace("/", " a "), distances, noise_px, rate)
                try:
                    rms, own, share = scored(box, folder, "smoother")
                except midspan.UntrustedError:
                    lines.append((what, "refused", "", "", ""))
                    continue
                lines.append((what, rms, own, f"{100.0 * share:.1f} %", ""))
                verdicts.append((what, share, ALONE_INSIDE, "inside", True))
        show(("targets", "error mm", "own band mm", "inside", "goal"), lines)
        for what, value, limit, unit, at_least in verdicts:
            goal(what, value, limit, unit=unit, at_least=at_least)
        for distances in ((3.0,), (3.0, 10.0)):
            cost(root, distances)


def cost(root: Path, distances_m: tuple[float, ...]) -> None:
    """Processor time of a record without a tilt over that without a look for it."""
    folder = Box(3, tilts=False).write(root / f"still {len(distances_m)}", distances_m, *USUAL)

    def spent_s() -> float:
        start = time.process_time()
        midspan.estimate(folder)
        return time.process_time() - start

    spent_s()
    with_look, without = [], []
    for _ in range(TIMES):
        with_look.append(spent_s())
        with patch("midspan.calibration.camera.calibrate.tilt_of", lambda *_: None):
            without.append(spent_s())
    what = f"processor time, {len(distances_m)} target{'s' if len(distances_m) > 1 else ''}, no tilt"
    goal(f"{what} ({min(with_look):.2f} s)", min(with_look) / min(without), MAX_COST)


if __name__ == "__main__":
    main()
