"""How many functions a frame passes through a live point, and an estimate with a given calibration.

Counted are the functions with a name (no comprehensions) of midspan and of its compiled core that are entered at least
once, and the modules that they stand in; what only importing enters is left out.
"""

import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import midspan
from benchmarks.engine_load import BLOCK_S, FRAME_HZ, M_PER_PX, PERIOD, SAMPLE_HZ, SPEED_HZ, film, moved_px, point
from benchmarks.table import goal
from midspan.engine.point import ACCELEROMETER
from midspan.records import NANOSECONDS, Arrival, Frame, Readings
from midspan.simulate.scenarios.write import write

# Long enough for the template to be learned; counted is the last one, in blocks like those that a sensor sends.
SECONDS = 20
ROOM = f"{Path(midspan.__file__).parent}/"


class Entered:
    """The functions (module, name, line) that were entered."""

    def __init__(self) -> None:
        self.functions: set[tuple[str, str, int]] = set()

    def during(self, work: Callable[[], Any]) -> "Entered":
        """Run `work` and keep what it enters, in threads that it starts too."""
        threading.setprofile(self._seen)
        sys.setprofile(self._seen)
        try:
            work()
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
        return self

    def _seen(self, frame: FrameType, event: str, called: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(ROOM) and not code.co_name.startswith("<"):
            self.functions.add((code.co_filename, code.co_name, code.co_firstlineno))
        elif event == "c_call" and "_core" in str(getattr(called, "__module__", "") or type(called.__self__)):
            self.functions.add(("_core", called.__qualname__, 0))

    def modules(self) -> set[str]:
        """The modules that the functions stand in."""
        return {file for file, _, _ in self.functions}


def through_a_point() -> Entered:
    """What frames and the acceleration between them enter once the target's template is learned."""
    pictures = film()
    one = point(Frame(0, pictures[0]))
    step_ns, entered = NANOSECONDS // SAMPLE_HZ, Entered()
    samples, frames = round(SAMPLE_HZ * BLOCK_S), round(FRAME_HZ * BLOCK_S)
    for block in range(round(SECONDS / BLOCK_S)):
        number = samples * block + np.arange(samples)
        value = -M_PER_PX * (2 * np.pi * SPEED_HZ) ** 2 * moved_px(number / SAMPLE_HZ)
        numbers = range(frames * block, frames * (block + 1))
        seen = [Frame(round(j * NANOSECONDS / FRAME_HZ), pictures[j % PERIOD], j) for j in numbers]
        arrivals = [
            Arrival(ACCELEROMETER, block, Readings(number * step_ns, value[:, None])),
            *(Arrival("camera", frame.index, frame) for frame in seen),
        ]
        # The frames of a block pass when the acceleration after them has come.
        watched = entered.during if block * BLOCK_S >= SECONDS - 1 else lambda work: work()
        for arrival in arrivals:
            watched(lambda arrival=arrival: one.push(arrival))
    return entered


def through_an_estimate(scenario: str, folder: Path) -> Entered:
    """What `estimate` of a scenario enters with `kalman` and a calibration."""
    write(scenario, folder, seed=0)
    calibration = midspan.calibrate(folder)
    midspan.estimate(folder, method="kalman", calibration=calibration)
    return Entered().during(lambda: midspan.estimate(folder, method="kalman", calibration=calibration))


def main() -> None:
    found = {"a frame": (through_a_point(), 40, 15)}
    with tempfile.TemporaryDirectory() as name:
        for what, scenario in (("of a displacement sensor", "gnss"), ("of a camera", "footbridge")):
            estimate = through_an_estimate(scenario, Path(name) / scenario)
            found[f"an estimate {what}"] = (estimate, 450, 80)
    for what, (entered, functions, modules) in found.items():
        goal(f"functions entered by {what}", len(entered.functions), functions)
        goal(f"modules entered by {what}", len(entered.modules()), modules)
        for line in sorted(entered.functions) if "--list" in sys.argv else ():
            print("   ", *line)
