"""midspan next to other software in one run: trackers on a film of 2000 frames, fusion on a record of 1000 s.

`python -m benchmarks peers`; with `--docs` it writes docs/peers.md. Each library works in a process of its own, on
one thread, in the environment that `sh tools/peers.sh` makes (pyidi brings another OpenCV than midspan's). Time is
processor time of the whole call after one call on a small part; memory is the process's peak.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import track_speed
from benchmarks.peer_work import EVERY, FAST_HZ, WARM_FRAMES, WORKS
from benchmarks.table import goal, show
from midspan.records import Floats
from midspan.simulate.motion.motion import Sines
from midspan.simulate.motion.sensors import noise_std_for

ROOT = Path(__file__).parents[1]
PEERS = ROOT / ".peers-venv" / "bin" / "python"
FRAMES, LIMIT_S = 2000, 600.0
ROUNDS, SHORT_S = 3, 5.0  # a work that takes longer is done once: chance changes it less than its factor
DURATION_S, SNR_DB = 1000.0, 40.0
PHASES = np.array([0.3, 1.7, 2.9, 4.1, 5.3])
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TRACKERS = tuple(WORKS)[:4]
PAGE = """# Other software, in one run

Made by `python -m benchmarks peers --docs` (environment: `sh tools/peers.sh`). Processor time of one call on one
thread, without imports; error: rms without its mean; memory: the process's peak.

## Trackers

{frames} frames of 192 × 240 px, a region of 128 px, motion up to 5 px, noise of 2 grey values; each library with
its own defaults. scikit-image resolves 1/100 px.

{trackers}

## Fusion

1000 s of five tones from 0.05 to 10.3 Hz; acceleration at 100 Hz, displacement at 10 Hz, 40 dB each. filterpy, pykalman
and statsmodels run one model (displacement, velocity, bias) with both noise levels known, as midspan does; SciPy's
cut-off is 1 Hz.

{fusion}
"""


def write(folder: Path) -> Floats:
    """The film and the record; returns the record's true displacement, m."""
    track_speed.FRAMES = FRAMES
    track_speed.write(folder / "stack.npy")
    np.save(folder / "warm.npy", np.load(folder / "stack.npy", mmap_mode="r")[:WARM_FRAMES])
    # The paper beam's modes and slow bumps as tones, whose sampling is exact and takes no fine steps.
    motion = Sines(np.array([2e-3, 3e-3, 1e-3, 3e-4, 1e-4]), np.array([0.05, 0.7, 3.1, 8.0, 10.3]), phase_rad=PHASES)
    time = np.arange(round(DURATION_S * FAST_HZ)) / FAST_HZ
    accel, truth_m = motion.acceleration(time), motion.displacement(time)
    accel_std, displacement_std = noise_std_for(accel, SNR_DB), noise_std_for(truth_m, SNR_DB)
    rng = np.random.default_rng(0)
    sparse = np.full(len(time), np.nan)
    sparse[::EVERY] = truth_m[::EVERY] + rng.normal(0.0, displacement_std, len(sparse[::EVERY]))
    noisy = accel + rng.normal(0.0, accel_std, len(accel))
    np.savez(
        folder / "record.npz", accel=noisy, displacement=sparse, accel_std=accel_std, displacement_std=displacement_std
    )
    return truth_m


def run(name: str, folder: Path) -> dict[str, float | str]:
    """Best processor time of a few rounds (long works: of one), with peak memory and version."""
    python = sys.executable if WORKS[name][1] in ("midspan", "scipy") else str(PEERS)
    words = [python, str(ROOT / "benchmarks" / "peer_work.py"), name, str(folder)]
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(ROOT / "src") if python == sys.executable else ""}
    best: dict[str, float | str] = {}
    for _ in range(ROUNDS):
        printed = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=True)
        found = json.loads(printed.stdout.splitlines()[-1])
        best = found if not best or found["took_s"] < best["took_s"] else best
        if found["took_s"] > SHORT_S:
            break
    return best


def fusion_error_mm(found: Floats, truth_m: Floats) -> float:
    """Without the mean and five seconds at each end, mm."""
    error = 1e3 * (found - truth_m[-len(found) :])[500:-500]
    return float(np.std(error))


def main() -> None:
    if not PEERS.is_file():
        print("Needs the other libraries: sh tools/peers.sh installs them.", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory(prefix="midspan-peers-") as name:
        folder = Path(name)
        truth_m = write(folder)
        found = {work: run(work, folder) for work in WORKS}
        error = {
            work: track_speed.rms(np.load(folder / f"{work}.npy"))
            if work in TRACKERS
            else fusion_error_mm(np.load(folder / f"{work}.npy"), truth_m)
            for work in WORKS
        }
    rows = {
        work: [work, one["version"], float(one["took_s"]), error[work], f"{float(one['peak_mb']):.0f}"]
        for work, one in found.items()
    }
    trackers = ["tracker", "version", "s", "error px", "peak MB"], [rows[work] for work in TRACKERS]
    fusion = ["fusion", "version", "s", "error mm", "peak MB"], [rows[work] for work in WORKS if work not in TRACKERS]
    show(*trackers)
    show(*fusion)
    took = {work: float(one["took_s"]) for work, one in found.items()}
    for peer, factor in (("OpenCV ZNCC and parabola", 5.0), ("pyidi Lucas-Kanade", 20.0)):
        goal(f"midspan track against {peer}", took[peer] / took["midspan track"], factor, unit="times", at_least=True)
        goal(f"its error against that of {peer}", error["midspan track"] / error[peer], 1.0)
    goal("fusion against filterpy", took["filterpy RTS"] / took["midspan smoother"], 50.0, unit="times", at_least=True)
    if "--docs" in sys.argv:
        page = PAGE.format(frames=FRAMES, trackers=markdown(*trackers), fusion=markdown(*fusion))
        (ROOT / "docs" / "peers.md").write_text(page, encoding="utf-8")


def markdown(head: list[str], rows: list[list[object]]) -> str:
    """The same table for a page."""
    texts = [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in line] for line in rows]
    lines = [head, ["---"] * len(head), *texts]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    main()
