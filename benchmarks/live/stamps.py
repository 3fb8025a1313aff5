"""The stamps of a network camera's frames against the clock that is drawn into the pictures."""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.servers import CLOCK_SHAPE, RtspCamera
from benchmarks.table import goal
from midspan.records import NANOSECONDS
from midspan.sources.live.camera import Stamped, StampKind, frames

LENGTH_S, RATE_HZ = 60.0, 30
BITS, PER_S = 24, 10_000
STRIPE = CLOCK_SHAPE[2] // BITS
GOAL_MS = 1.0


def drawn_ms(stamped: Stamped) -> float:
    """What a frame's stamp is later than the time drawn into it, ms."""
    middle = stamped.frame.pixels[CLOCK_SHAPE[1] // 2]
    lit = middle[STRIPE // 2 : BITS * STRIPE : STRIPE] > 128
    ticks = int("".join("1" if one else "0" for one in lit), 2)
    stamp = stamped.frame.time_ns * PER_S / NANOSECONDS
    return float((stamp - ticks + 2 ** (BITS - 1)) % 2**BITS - 2 ** (BITS - 1)) * 1e3 / PER_S


def main() -> int:
    """Watch the clock for a minute; print what the stamps are off by, for each way that they were found."""
    if not RtspCamera.is_installed():
        print("Needs GStreamer's RTSP server: sh tools/servers.sh installs it.", file=sys.stderr)
        return 2
    off: dict[StampKind, list[float]] = {kind: [] for kind in StampKind}
    with tempfile.TemporaryDirectory(prefix="midspan-stamps-") as name:
        camera = RtspCamera(Path(name), None, RATE_HZ)
        camera.start()
        try:
            until_s = time.monotonic() + LENGTH_S
            for stamped in frames(camera.address):
                off[stamped.kind].append(drawn_ms(stamped))
                if time.monotonic() > until_s:
                    break
        finally:
            camera.stop()
    print(f"{'stamps by':>10} {'frames':>7} {'median':>8} {'5 %':>8} {'95 %':>8} {'largest':>8}  ms late")
    for kind, found in off.items():
        if found:
            low, middle, high = np.percentile(found, (5, 50, 95))
            largest = np.abs(found).max()
            print(f"{kind.value:>10} {len(found):7d} {middle:8.3f} {low:8.3f} {high:8.3f} {largest:8.3f}")
    goal(
        "stamps once the sender's clock is known, 95 %",
        float(np.percentile(np.abs(off[StampKind.SENDER]), 95)),
        GOAL_MS,
        unit="ms",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
