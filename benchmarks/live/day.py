"""A day of two points from stored tracks through the live engine into a store: memory, time, and what the store takes.

`python -m benchmarks.live.day [HOURS]`: 100 Hz of acceleration and a track of 10 frames a second, by `midspan replay`;
`python -m benchmarks.live.day HOURS pictures`: with the pictures themselves in place of the track.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.servers import command
from benchmarks.table import goal
from midspan.service.stored_recording import stored_table
from midspan.simulate.scene.texture import textured_scene
from midspan.store.store import open_store

HOURS, POINTS, FAST_HZ, SLOW_HZ = 24.0, ("a", "b"), 100.0, 10.0
NOISE_M_S2, NOISE_PX, MM_PER_PX = 2e-3, 0.02, -1.0
GOAL_GROWTH, GOAL_INSIDE = 0.05, 0.85
SETTINGS = """
[accelerometer]
file = "accel.parquet"
time = "time_s"
value = "accel"
unit = "m/s^2"
[camera]
direction = "y"
"""
TRACK, PICTURES = 'file = "track.parquet"\n', 'file = "frames.npy"\nrate_hz = 10.0\nroi = [16, 16, 64, 64]\n'
# Pictures begin again after this time.
PERIOD_S, SHAPE, GREY_NOISE = 60.0, (96, 96), 1.0


def write(folder: Path, hours: float, *, pictures: bool) -> np.ndarray:
    """A recording made of one random minute again and again, which joins smoothly; returns the displacement, mm."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng = np.random.default_rng(0)
    # Tones of whole cycles in a period.
    hertz = np.round(rng.uniform(0.3, 4.0, 6) * PERIOD_S) / PERIOD_S
    size_m, phase = rng.uniform(0.3e-3, 1.5e-3, 6), rng.uniform(0, 2 * np.pi, 6)
    fast, slow = (np.arange(int(hours * 3600 * rate)) / rate for rate in (FAST_HZ, SLOW_HZ))

    def tones(time_s: np.ndarray, order: int) -> np.ndarray:
        found = np.zeros(len(time_s))
        for f, m, p in zip(hertz, size_m, phase, strict=True):
            found += m * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * time_s + p + 0.5 * np.pi * order)
        return found

    accel = tones(fast, 2) + rng.normal(0, NOISE_M_S2, len(fast))
    y_px = 1e3 * tones(slow, 0) / MM_PER_PX + rng.normal(0, NOISE_PX, len(slow))
    pq.write_table(pa.table({"time_s": fast, "accel": accel}), folder / "accel.parquet")
    std = np.full(len(slow), NOISE_PX)
    track = {"time_s": slow, "x_px": rng.normal(0, NOISE_PX, len(slow)), "y_px": y_px, "std_x_px": std, "std_y_px": std}
    pq.write_table(pa.table(track), folder / "track.parquet")
    if pictures:
        scene = textured_scene("natural", SHAPE, rng=rng, reach_px=12.0)
        shift_px = 1e3 * tones(slow[: round(PERIOD_S * SLOW_HZ)], 0) / MM_PER_PX
        film = np.stack([scene.render(0.0, float(y)) for y in shift_px])
        frames = np.lib.format.open_memmap(folder / "frames.npy", mode="w+", dtype=np.uint8, shape=(len(slow), *SHAPE))
        for first in range(0, len(slow), len(film)):
            # The noise never repeats: what is measured has all its digits.
            part = film[: len(slow) - first] + rng.normal(0, GREY_NOISE, film[: len(slow) - first].shape)
            frames[first : first + len(film)] = np.clip(np.rint(part), 0, 255).astype(np.uint8)
        frames.flush()
    (folder / "recording.toml").write_text(SETTINGS + (PICTURES if pictures else TRACK))
    return 1e3 * tones(fast, 0)


def resident_mb(pid: int) -> float:
    """Memory of a process but for mapped files, which the system may drop, MB; 0 once it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon")), 0.0)


def replayed(folder: Path, store: Path, point: str) -> tuple[list[float], float]:
    """Replay into a store; memory (MB) once the calibration is made, every half second, and processor time, s."""
    import resource

    before_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    words = command("replay", folder, "-o", store, "--point", point, "--quiet", "-c", folder / "calibration.json")
    process, memory = subprocess.Popen(words), []
    while process.poll() is None:
        memory.append(resident_mb(process.pid))
        time.sleep(0.5)
    if process.returncode:
        raise RuntimeError(f"replay ended with {process.returncode}")
    return [one for one in memory if one], resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before_s


def main(hours: float = HOURS, *, pictures: bool = False) -> int:
    """Replay both points, and print what it took."""
    with tempfile.TemporaryDirectory(prefix="midspan-day-") as name:
        folder, store = Path(name), Path(name) / "store"
        truth = write(folder, hours, pictures=pictures)
        subprocess.run(command("calibrate", folder, "--quiet"), check=True)
        for point in POINTS:
            memory, busy_s = replayed(folder, store, point)
            tenth, last = max(memory[: len(memory) // 10 + 1]), max(memory[len(memory) // 10 :])
            print(f"        {point}: {last:.0f} MB, {3600 * hours / busy_s:.0f} times real time of one core")
            goal(f"{point}: growth of memory after the first tenth", last / tenth - 1.0, GOAL_GROWTH)
        megabytes = sum(path.stat().st_size for path in store.rglob("*") if path.is_file()) / 1e6
        print(f"        store: {24 * megabytes / hours / len(POINTS):.0f} MB a day and point")
        opened = open_store(str(store), read_only=True)
        table = stored_table(opened, POINTS[0], None, None)
        opened.close()
        index = np.rint(table.time_ns / 1e9 * FAST_HZ).astype(int)
        error = np.asarray(table.columns["displacement_mm"]) - truth[index] + truth[0]
        print(f"        rows: {len(error)}")
        inside = np.abs(error - np.mean(error)) < 1.96 * np.asarray(table.columns["displacement_std_mm"])
        goal("rows inside", float(np.mean(inside)), GOAL_INSIDE, at_least=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:2]), pictures="pictures" in sys.argv[2:]))
