"""`midspan track` on a long uncompressed stack compared with OpenCV's matchTemplate with a parabola, start-up taken
out.

Both run on one thread, on the same frames, in turns; the best round of each counts, by processor time, which a busy
machine changes less. The time of a run of SHORT frames
is taken off, so that what a run pays once (template, kernels, learning) is not in the rates.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap

from benchmarks.table import goal, show
from midspan.recording.tracking.track import track
from midspan.records import Floats, Region

FRAMES, SHORT, DISTINCT = 20_000, 1_000, 500
SHAPE, RATE_HZ = (192, 240), 100.0
REGION = Region(56, 32, 128, 128)
SEARCH_PX, ROUNDS = 8, 3
PEER_FRAMES = 2_000


def motion() -> Floats:
    """Translation (DISTINCT, 2: x, y) in px, up to 5 px, which begins again where it ends."""
    t = np.arange(DISTINCT) / RATE_HZ
    x = 4.2 * np.sin(2 * np.pi * 1.2 * t) + 0.7 * np.sin(2 * np.pi * 7.0 * t)
    return np.stack([x, 4.9 * np.sin(2 * np.pi * 0.8 * t)], axis=1)


def write(path: Path) -> None:
    """A band-limited texture that moves, with noise of 2 grey levels, over and over."""
    rng = np.random.default_rng(3)
    down, across = np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])
    radius = np.hypot(down, across)
    spectrum = np.fft.rfft2(rng.standard_normal(SHAPE)) * np.exp(-0.5 * (radius / 0.07) ** 2) * (radius < 0.18)
    spectrum[0, 0] = 0.0
    spectrum *= 35.0 / np.fft.irfft2(spectrum, s=SHAPE).std()
    frames = open_memmap(path, mode="w+", dtype=np.uint8, shape=(FRAMES, *SHAPE))
    for k, (x, y) in enumerate(motion()):
        image = 128 + np.fft.irfft2(spectrum * np.exp(-2j * np.pi * (across * x + down * y)), s=SHAPE)
        noisy = np.clip(np.rint(image + rng.normal(0, 2.0, SHAPE)), 0, 255).astype(np.uint8)
        frames[k::DISTINCT] = noisy
    frames.flush()


def by_midspan(path: Path) -> Floats:
    """`midspan track` as a function: translation (n, 2) in px."""
    found = track(path, roi=REGION, rate_hz=RATE_HZ).track
    return np.stack([found.x_px, found.y_px], axis=1)


def by_opencv(path: Path) -> Floats:
    """matchTemplate (zero-mean normalised) over ±SEARCH_PX and a parabola along each axis."""
    import cv2

    stack, r, n = np.load(path, mmap_mode="r"), REGION, SEARCH_PX
    template = np.array(stack[0][r.y : r.y + r.height, r.x : r.x + r.width])
    rows = []
    for image in stack[:PEER_FRAMES]:
        part = np.array(image)[r.y - n : r.y + r.height + n, r.x - n : r.x + r.width + n]
        surface = cv2.matchTemplate(part, template, cv2.TM_CCOEFF_NORMED)
        _, _, _, (i, j) = cv2.minMaxLoc(surface)
        rows.append((i - n + _peak(*surface[j, i - 1 : i + 2]), j - n + _peak(*surface[j - 1 : j + 2, i])))
    return np.array(rows)


def _peak(before: float, at: float, after: float) -> float:
    """Where the parabola through three values is largest, from the middle one."""
    return 0.5 * (before - after) / (before - 2 * at + after)


def rms(found: Floats) -> float:
    """Error (px) of a translation since the first frame without its mean, which is the first frame's own noise."""
    error = found - np.resize(motion(), found.shape)
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


def main() -> None:
    import cv2

    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as name:
        whole, short = Path(name) / "whole.npy", Path(name) / "short.npy"
        write(whole)
        np.save(short, np.load(whole, mmap_mode="r")[:SHORT])
        works = (lambda: by_midspan(whole), lambda: by_midspan(short), lambda: by_opencv(whole))
        best, found = [np.inf] * 3, [np.empty((0, 2))] * 3
        for _ in range(ROUNDS):
            for k, work in enumerate(works):
                start = time.process_time()
                found[k] = work()
                best[k] = min(best[k], time.process_time() - start)
    ours, peer = (FRAMES - SHORT) / (best[0] - best[1]), PEER_FRAMES / best[2]
    head = ["128 px, one thread", "frames/s", "error px"]
    show(head, [["midspan track", ours, rms(found[0])], ["matchTemplate and parabola", peer, rms(found[2])]])
    print(f"the first {SHORT} frames of `midspan track`: {best[1]:.2f} s")
    goal("a further frame against matchTemplate and parabola", ours / peer, 15.0, unit="times", at_least=True)
    first = PEER_FRAMES / (best[1] + (PEER_FRAMES - SHORT) / ours)
    goal(f"{PEER_FRAMES} frames with learning", first / peer, 5.0, unit="times", at_least=True)
