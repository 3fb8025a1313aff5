"""Replay of a calibrated radar target against a windowed FFT of every frame with scipy, one thread each."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.table import goal, show
from midspan.radar.following import bins_within
from midspan.radar.layout import Cube, Layout, Words, pack, unpack
from midspan.radar.range_profile import hann, slow_time
from midspan.simulate.radar.setup import demo_settings
from midspan.simulate.radar.signal import SHORT_RANGE, beat
from midspan.sources.radar.dca1000 import RawCapture
from midspan.sources.radar.radar_source import RadarRequest

CHIRP, RANGE_M, FRAMES, BATCH = SHORT_RANGE, 1.318, 4000, 100
FOLLOWED_M = 0.04
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def best(work: Callable[[], object], repeats: int = 7) -> float:
    """Seconds of the fastest of a few runs."""
    found = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        found = min(found, time.perf_counter() - start)
    return found


def compare() -> None:
    """One calibrated bin straight from the words, 4 receivers of 256 samples, against the whole profile."""
    from scipy.fft import fft

    layout = Layout(CHIRP)
    echo = 500 * beat(np.full(BATCH, RANGE_M), CHIRP)[:, None, None, :].repeat(4, axis=2)
    words = np.tile(pack(echo, layout), FRAMES // BATCH)
    window, ready = hann(CHIRP.samples).astype(np.float32), unpack(words, layout)
    size = BATCH * layout.frame_words

    def whole(cube: Cube | None) -> None:
        for k in range(FRAMES // BATCH):
            part = (
                unpack(words[k * size : (k + 1) * size], layout) if cube is None else cube[k * BATCH : (k + 1) * BATCH]
            )
            fft(part * window, axis=-1, workers=1)

    ours = best(lambda: slow_time(words, layout, np.array([RANGE_M / CHIRP.bin_m])))
    place = RANGE_M / CHIRP.bin_m
    followed = best(lambda: slow_time(words, layout, bins_within(place, FOLLOWED_M / CHIRP.bin_m)))
    unpacked, ready_made = best(lambda: whole(None)), best(lambda: whole(ready))
    read, read_whole = from_disk(words, layout)
    rows = [
        ["one bin from the words", 1e6 * ours / FRAMES, 1.0],
        ["all bins of a motion of 40 mm, to follow it", 1e6 * followed / FRAMES, followed / ours],
        ["unpack, window, FFT", 1e6 * unpacked / FRAMES, unpacked / ours],
        ["window, FFT of unpacked samples", 1e6 * ready_made / FRAMES, ready_made / ours],
    ]
    rows.append(["capture on disk: one bin", 1e6 * read / FRAMES, 1.0])
    rows.append(["capture on disk: whole profiles", 1e6 * read_whole / FRAMES, read_whole / read])
    show(["", "µs a frame", "ratio"], rows)
    goal("times faster than a windowed FFT of every frame", unpacked / ours, 6.0, at_least=True)
    goal("the same from a capture on disk, holes looked for", read_whole / read, 6.0, at_least=True)
    goal("the same with the bins of a motion of 40 mm", unpacked / followed, 6.0, at_least=True)
    goal("the same against samples that are unpacked already", ready_made / ours, 6.0, at_least=True)


def from_disk(words: Words, layout: Layout) -> tuple[float, float]:
    """Seconds for a capture read as one bin, and as whole profiles."""
    with tempfile.TemporaryDirectory() as folder:
        capture, settings = Path(folder) / "adc.bin", Path(folder) / "radar.cfg"
        capture.write_bytes(words.tobytes())
        settings.write_text(demo_settings(CHIRP, order=layout.order))
        source = RawCapture(capture, RadarRequest(settings))
        place = np.array([RANGE_M / CHIRP.bin_m])
        return best(lambda: list(source.slow_time(place))), best(lambda: [None for _ in source.profiles()])


def main() -> None:
    """Run in a process of one thread: the number of threads is fixed when NumPy is loaded."""
    environment = os.environ | dict.fromkeys(THREADS, "1")
    subprocess.run(
        [sys.executable, "-c", "from benchmarks.radar_replay import compare; compare()"], env=environment, check=True
    )
