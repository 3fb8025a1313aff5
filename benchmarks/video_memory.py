"""A lossless video of 10 000 frames of 320 by 240 through the tracking of `midspan track`: memory and speed."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.table import PEAK, goal

FRAMES, SHAPE = 10_000, (240, 320)
CHILD = (
    PEAK
    + """
import sys, time
start = time.perf_counter()
from midspan.cli.main import main
sys.argv = ["midspan", "track", sys.argv[1], "--quiet", "-o", sys.argv[2]]
code = 0
try:
    main()
except SystemExit as end:
    code = end.code or 0
print(code, time.perf_counter() - start, peak_mb())
"""
)


def frames():
    """A textured picture that moves up and down by whole and half pixels, with noise."""
    from scipy.ndimage import gaussian_filter, shift

    rng = np.random.default_rng(0)
    scene = gaussian_filter(rng.normal(0, 1.0, (SHAPE[0] + 40, SHAPE[1])), 1.5)
    scene = 120.0 + 40.0 * scene / scene.std()
    moved = [shift(scene, (0.25 * k, 0.0), order=3, mode="nearest") for k in range(4)]
    noise = rng.normal(0, 2.0, (8, *SHAPE))
    for k in range(FRAMES):
        step = round(4 * (10.0 + 6.0 * np.sin(2 * np.pi * k / 90.0)))
        top = step // 4
        picture = moved[-step % 4][top + (1 if step % 4 else 0) : top + (1 if step % 4 else 0) + SHAPE[0]]
        yield np.clip(picture + noise[k % 8], 0, 255).astype(np.uint8)


def main() -> None:
    from midspan.simulate.files.folder import write_video

    with tempfile.TemporaryDirectory() as name:
        video, out = Path(name) / "video.mkv", Path(name) / "track.csv"
        write_video(video, frames(), stamps_s=np.arange(FRAMES) / 25.0, rate_hz=25.0, done=lambda count: None)
        whole = FRAMES * SHAPE[0] * SHAPE[1] / 1e6
        print(f"video of {video.stat().st_size / 1e6:.0f} MB; its frames in one array would take {whole:.0f} MB")
        done = subprocess.run(
            [sys.executable, "-c", CHILD, str(video), str(out)], capture_output=True, text=True, check=False
        )
        lines = done.stdout.split("\n")
        if done.returncode or len(lines) < 1 or not out.exists():
            print(done.stdout[-1000:], done.stderr[-2000:])
            return
        _, seconds, megabytes = (float(x) for x in done.stdout.split()[-3:])
        rows = len(out.read_text().splitlines()) - 1
    print(f"{rows} rows; {1e3 * seconds / FRAMES:.2f} ms a frame, start included")
    goal("peak memory", megabytes, 600.0, unit="MB")
