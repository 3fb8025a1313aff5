"""Three points through a real RTSP camera, MQTT and the store, for a minute and a half: `make live`.

A camera and two displacement sensors; halfway one of them falls silent, and comes back.
"""

import contextlib
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.sensors import Transmitter, film, motion
from benchmarks.live.servers import Mosquitto, RtspCamera
from benchmarks.live.site import RunningSite, whole_site
from midspan.records import NANOSECONDS

LENGTH_S, STEP_S, SILENT_S = 100.0, 5.0, (70.0, 82.0)
CAMERA_HZ, SHAPE = 15, (240, 320)


def main() -> int:
    """Run the site, print how it stands every five seconds, and how its rows compare with the truth."""
    if Mosquitto.program() is None or not RtspCamera.is_installed():
        print("Needs mosquitto and GStreamer's RTSP server: sh tools/servers.sh installs them.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-live-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        motions = {point: motion(seed) for seed, point in enumerate(("quarter-span", "midspan", "pier"))}
        films = {"quarter-span": film(motions["quarter-span"], SHAPE, CAMERA_HZ)}
        site, sensors = whole_site(stack, folder, motions, films, CAMERA_HZ)
        watch(site, sensors)
        code = site.stop()
        begun_ns = time.time_ns() - round(30 * NANOSECONDS)
        for point in motions:
            held = site.held(point, begun_ns, 2**62)
            print(f"{point}: {held.rows} rows of the last seconds, {held.rms_mm:.3f} mm rms, {held.inside:.1%} inside")
        print((folder / "log.txt").read_text())
        return code


def watch(site: RunningSite, sensors: Transmitter) -> None:
    """Print what every point gives and what is wrong, until the end."""
    begun_s = time.monotonic()
    print(f"{'s':>4}  {'newest row, s ago':40} what is wrong")
    for step in range(1, round(LENGTH_S / STEP_S) + 1):
        time.sleep(max(begun_s + step * STEP_S - time.monotonic(), 0.0))
        sensors.faults["acc/pier"].silent = SILENT_S[0] <= step * STEP_S < SILENT_S[1]
        ages = {}
        for name in site.motions:
            with contextlib.suppress(Exception):
                ages[name] = site.rows_s(name)
        shown = ", ".join(f"{name} {age:.1f}" for name, age in ages.items() if np.isfinite(age)) or "none yet"
        wrong = ", ".join(f"{where}: {reason}" for where, reason in site.reasons().items())
        print(f"{step * STEP_S:4.0f}  {shown:40} {wrong}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
