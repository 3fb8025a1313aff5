"""24 hours of 100 Hz acceleration and 10 Hz displacement from Parquet through `midspan.estimate`: time and memory."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.table import PEAK, goal
from midspan.simulate.motion.motion import random_motion

HOURS = 24.0
CHILD = (
    PEAK
    + """
import sys, time
start = time.perf_counter()
import midspan
result = midspan.estimate(midspan.open_recording(sys.argv[1]))
result.save(sys.argv[1] + "/result.parquet")
print(time.perf_counter() - start, peak_mb(), len(result.time_s))
"""
)


def write(folder: Path) -> None:
    """A day made of one random hour again and again, with fresh noise."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng = np.random.default_rng(0)
    motion = random_motion((0.1, 4.0), 2e-3, rng=rng, flat="velocity")
    for name, rate, noise, column in (("accel", 100.0, 2e-3, "accel"), ("gnss", 10.0, 5e-4, "height")):
        time = np.arange(int(HOURS * 3600 * rate)) / rate
        hour = np.arange(int(3600 * rate)) / rate
        value = motion.acceleration(hour) if name == "accel" else motion.displacement(hour)
        # At each full hour the motion starts again with a jump, which the gate has to get over: part of the work.
        value = np.resize(value, len(time)) + rng.normal(0, noise, len(time))
        pq.write_table(pa.table({"time_s": time, column: value}), folder / f"{name}.parquet")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.parquet"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        '[displacement]\nfile = "gnss.parquet"\ntime = "time_s"\nvalue = "height"\nunit = "m"\n'
    )


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        write(Path(name))
        done = subprocess.run([sys.executable, "-c", CHILD, name], capture_output=True, text=True, check=False)
        if done.returncode:
            print(done.stderr[-2000:])
            return
        seconds, megabytes, rows = (float(x) for x in done.stdout.split())
    print(f"{rows:.0f} rows, reading, calibration, fusion and writing of Parquet included")
    goal("wall time", seconds, 30.0, unit="s")
    goal("peak memory", megabytes, 2000.0, unit="MB")
