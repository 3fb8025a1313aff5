"""`kill -9` of each process of a site at random moments: `python -m benchmarks.live.kills [TIMES]`.

The service is started again as a service manager does; a camera's process is the service's to start again. For each:
after how long rows are new again. In the end: samples and rows that were lost or doubled, and whether the rows hold the
truth.
"""

import contextlib
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.load import children, whole
from benchmarks.live.sensors import film, motion
from benchmarks.live.servers import Mosquitto, RtspCamera
from benchmarks.live.site import RunningSite, whole_site
from benchmarks.table import goal

TIMES, BACK_S, MIN_INSIDE = 50, 5.0, 0.85
CAMERA_HZ, SHAPE, FILMED, PLAIN = 15, (240, 320), "filmed", "plain"
# Rows are new where they are no older than this, s: blocks of 0.2 s, read back from the store's commits.
NEW_S, PAUSE_S, GIVEN_UP_S = 1.5, (1.0, 8.0), 60.0


def new_again(site: RunningSite, since_s: float) -> float:
    """Wait until all is well and every point's rows are new; returns the time since an instant, s."""
    while (lasted_s := time.monotonic() - since_s) < GIVEN_UP_S:
        with contextlib.suppress(Exception):
            status, _ = site.standing()
            if status == 200 and all(site.rows_s(name) < NEW_S for name in site.motions):
                return lasted_s
        time.sleep(0.1)
    return np.inf


def killed(site: RunningSite, rng: np.random.Generator) -> tuple[str, float]:
    """Kill one of the processes; returns which, and how long it took until rows were new, s."""
    assert site.process is not None
    own = children(site.process.pid)
    which = int(rng.integers(-1, len(own)))
    since_s = time.monotonic()
    if which < 0 or not own:
        site.stop(kill=True)
        site.start()
        return "service", new_again(site, since_s)
    with contextlib.suppress(ProcessLookupError):
        os.kill(own[which], signal.SIGKILL)
    # The camera's frames on their way are still to be seen.
    time.sleep(NEW_S)
    return "camera", new_again(site, since_s)


def main(times: int = TIMES) -> int:
    """Kill, and print how it came back."""
    if Mosquitto.program() is None or not RtspCamera.is_installed():
        print("Needs mosquitto and GStreamer's RTSP server: sh tools/servers.sh installs them.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-kills-") as name, contextlib.ExitStack() as stack:
        folder, rng = Path(name), np.random.default_rng(0)
        motions = {point: motion(seed) for seed, point in enumerate((FILMED, PLAIN))}
        site, _ = whole_site(stack, folder, motions, {FILMED: film(motions[FILMED], SHAPE, CAMERA_HZ)}, CAMERA_HZ)
        stack.callback(lambda: site.stop())
        new_again(site, time.monotonic() + 120.0)
        back_s: dict[str, list[float]] = {}
        for _ in range(times):
            time.sleep(float(rng.uniform(*PAUSE_S)))
            which, lasted_s = killed(site, rng)
            back_s.setdefault(which, []).append(lasted_s)
            print(f"        {which:8} back after {lasted_s:.1f} s", flush=True)
        for which, lasted in back_s.items():
            goal(f"{which} killed {len(lasted)} times: back at the latest", max(lasted), BACK_S, unit="s")
        whole(site)
        for point in motions:
            held = site.held(point, 0, 2**62)
            goal(f"{point}: inside", held.inside, MIN_INSIDE, at_least=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
