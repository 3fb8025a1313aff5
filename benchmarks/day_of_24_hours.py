"""A day of two cameras at 2 Hz, rendered while it is tracked: error, memory, and every second accounted for.

`python -m benchmarks.day_of_24_hours HOURS` runs this many hours of sun in this many hours of frames; all 24 without.
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import midspan
from benchmarks.table import PEAK, goal, show
from midspan.recording.result import Result
from midspan.recording.streams.recording import Recording
from midspan.records import Floats, Frame, Nanoseconds, Source, Status, TimeSeries, nanoseconds
from midspan.simulate.day.infrared import DayCourse
from midspan.simulate.day.setup import CameraPlan, DaySetup, hours
from midspan.simulate.day.sky import Headlights, Sky
from midspan.simulate.motion.motion import Motion, Sum, Window, random_motion
from midspan.simulate.scene.scene import Image
from midspan.simulate.scene.thermal import ThermalCamera
from midspan.vision.frame_source import FrameInfo, FrameSource

RATE_HZ, ACCELERATION_HZ = 2.0, 20.0
NOISE_M_S2 = 1e-3
PIECE = 20_000
SETTINGS = """
[accelerometer]
file = "rendered.csv"
[camera]
file = "rendered.mkv"
roi = [42, 10, 44, 44]
[infrared]
file = "rendered.npz"
roi = [42, 10, 44, 44]
tracker = "template"
"""


@dataclass(frozen=True)
class Rendered(FrameSource):
    """Frames that are made when they are asked for, at stamps (n,) in s on their own clock."""

    stamps_s: Floats
    draw: Callable[[int], "Image | np.ndarray"]
    shape: tuple[int, int]
    thermal: bool

    @property
    def info(self) -> FrameInfo:
        """Size and number of the frames."""
        rows, columns = self.shape
        depth, count = 32 if self.thermal else 8, len(self.stamps_s)
        return FrameInfo(columns, rows, depth, count, "rendered", True, radiometric=self.thermal)

    def times_ns(self) -> Nanoseconds:
        """Time stamps (n,) in ns."""
        return nanoseconds(self.stamps_s)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames start … stop-1."""
        times = self.times_ns()
        for k in range(*slice(start, stop).indices(len(times))):
            yield Frame(int(times[k]), self.draw(k), k)


def in_pieces(function: Callable[[Floats], Floats], time_s: Floats) -> Floats:
    """A motion at many times (n,), a piece after another: each takes memory times its number of sines."""
    return np.concatenate([function(time_s[k : k + PIECE]) for k in range(0, len(time_s), PIECE)])


def swaying(rng: np.random.Generator) -> Motion:
    """A mode at 0.5 Hz and a slow sag."""
    parts = (
        random_motion((0.45, 0.55), 1.2e-3, rng=rng, lines=30),
        random_motion((0.002, 0.02), 2.0e-3, rng=rng, lines=20),
    )
    return Window(Sum(parts), start_s=1.5, ramp_s=2.0)


def setup_of(day_s: float) -> DaySetup:
    """Two small cameras under a sky whose 24 hours last `day_s`."""
    night = np.arange(6.8, 17.2, 1.5)
    return DaySetup(
        sky=Sky(length_s=day_s, fog=((day_s * 17.4 / 24, day_s * 19.0 / 24),), ramp_s=day_s / 100),
        camera=CameraPlan((64, 88), scale_mm_per_px=-1.0, rate_hz=RATE_HZ, time_offset_s=0.1),
        infrared=CameraPlan((64, 88), scale_mm_per_px=-1.1, rate_hz=RATE_HZ, start_s=0.2, time_offset_s=-0.08),
        course=DayCourse(14.0, 6.0, day_s),
        thermal=ThermalCamera(pattern_k=0.03, shutters_s=hours(day_s, *np.arange(0.7, 24.0, 0.5)), closed_s=0.9),
        cars=Headlights(hours(day_s, *night), row_px=56.0, reach_px=25.0),
        reach_px=12.0,
    )


def rendered(plan: CameraPlan, motion: Motion, duration_s: float, camera: object) -> Rendered:
    """The frames of one camera of the day."""
    stamps = plan.stamps_s(duration_s)
    down = in_pieces(motion.displacement, stamps + plan.time_offset_s) / (1e-3 * plan.scale_mm_per_px)
    moved, times = np.stack([np.zeros_like(down), down], axis=1), stamps + plan.time_offset_s
    thermal = hasattr(camera, "film_number")
    if thermal:
        return Rendered(stamps, lambda k: camera.film_number(k, moved, times), plan.size_px, True)  # type: ignore[attr-defined]
    return Rendered(stamps, lambda k: camera.picture(k, moved[k], float(times[k])), plan.size_px, False)  # type: ignore[attr-defined]


def recording_of(folder: Path, day_s: float, duration_s: float, seed: int = 0) -> tuple[Recording, Motion]:
    """A recording whose frames are rendered and whose acceleration is in memory, and its true motion."""
    window = [0.0, min(90.0, 0.2 * day_s)]  # by day
    (folder / "recording.toml").write_text(f"{SETTINGS}[calibration]\nwindow_s = {window}\n")
    rng_motion, rng_noise, rng_camera, rng_infrared = np.random.default_rng(seed).spawn(4)
    motion, setup = swaying(rng_motion), setup_of(day_s)
    time = np.arange(int(duration_s * ACCELERATION_HZ)) / ACCELERATION_HZ
    value = in_pieces(motion.acceleration, time) + NOISE_M_S2 * rng_noise.standard_normal(len(time))
    recording = midspan.open_recording(folder)
    camera, infrared = recording.cameras
    # What is read from files otherwise is put in its place.
    recording.acceleration = TimeSeries(nanoseconds(time), value, "acceleration", "m/s^2")
    camera.frames = rendered(setup.camera, motion, duration_s, setup.day_camera(setup.camera, rng_camera))
    infrared.frames = rendered(setup.infrared, motion, duration_s, setup.day_infrared(rng_infrared))
    return recording, motion


@dataclass(frozen=True)
class Account:
    """What became of a day: rms error by 24th part in mm, share inside 1.96 σ, seconds without a row, shares."""

    rms_mm: Floats
    largest_mm: float
    inside: float
    seconds_missing: int
    shares: dict[str, float]
    longest_coast_s: float


def account(result: Result, motion: Motion, zero_s: float) -> Account:
    """Compare the result with the truth, whose zero is at `zero_s`, and count its seconds."""
    time, rows = result.time_s, result.estimate
    truth = 1e3 * (in_pieces(motion.displacement, time) - motion.displacement(np.array([zero_s])))
    error = result.displacement_mm - truth
    parts = np.array_split(np.arange(len(time)), 24)
    seen = np.unique(np.floor(time).astype(np.int64))
    coasting = np.concatenate(([0], (rows.status != Status.TRACKING).astype(np.int8), [0]))
    edges = np.flatnonzero(np.diff(coasting)).reshape(-1, 2)
    shares = {s.word: float(np.mean(rows.status == s)) for s in Status}
    shares |= {s.word: float(np.mean(rows.source == s)) for s in Source if np.any(rows.source == s)}
    return Account(
        np.array([float(np.sqrt(np.mean(error[p] ** 2))) for p in parts]),
        float(np.abs(error).max()),
        float(np.mean(np.abs(error) < 1.96 * result.displacement_std_mm)),
        int(seen[-1] - seen[0] + 1 - len(seen)),
        shares,
        float(np.max(edges[:, 1] - edges[:, 0], initial=0)) / ACCELERATION_HZ,
    )


def run(day_s: float, duration_s: float) -> Account:
    """Calibrate and estimate a day that is rendered on the way."""
    with tempfile.TemporaryDirectory() as name:
        recording, motion = recording_of(Path(name), day_s, duration_s)
        result = midspan.estimate(recording)
        return account(result, motion, setup_of(day_s).first_s)


CHILD = (
    PEAK
    + """
import sys, time
from benchmarks.day_of_24_hours import run
start = time.perf_counter()
found = run(float(sys.argv[1]), float(sys.argv[2]))
print(time.perf_counter() - start, peak_mb())
print(repr({"rms": found.rms_mm.tolist(), "largest": found.largest_mm, "inside": found.inside,
    "missing": found.seconds_missing, "shares": found.shares, "coast": found.longest_coast_s}))
"""
)


def measured(day_s: float, duration_s: float) -> tuple[float, float, dict]:
    """Wall time in s, peak memory in MB, and the account, from a process of its own."""
    command = [sys.executable, "-c", CHILD, str(day_s), str(duration_s)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, second = done.stdout.strip().splitlines()[-2:]
    seconds, megabytes = (float(x) for x in first.split())
    return seconds, megabytes, eval(second)


def main(hours_wanted: float = 24.0) -> None:
    duration = 3600.0 * hours_wanted
    short, long = (measured(86_400.0 * hours_wanted / 24.0, share * duration) for share in (1 / 8, 1.0))
    print(f"{hours_wanted:g} h of frames at {RATE_HZ:g} Hz; the sun goes round once meanwhile")
    show(["part of the day", "rms mm"], [[k, value] for k, value in enumerate(long[2]["rms"])])
    print(f"shares: {long[2]['shares']}; longest without a measurement: {long[2]['coast']:.1f} s")
    goal("rms error of the worst 24th", max(long[2]["rms"]), 0.3, unit="mm")
    goal("inside 1.96 standard deviations", 100 * long[2]["inside"], 93, unit="%", at_least=True)
    goal("seconds without a row", long[2]["missing"], 0)
    frames = 2 * RATE_HZ * duration * 7 / 8
    goal("memory a frame, rows included", (long[1] - short[1]) * 1e6 / frames, 3000.0, unit="bytes")
    goal("wall time a frame", 1e3 * long[0] / (2 * RATE_HZ * duration), 25.0, unit="ms")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 24.0)
