"""A live engine's load: 4 cameras at 30 frames/s and 20 accelerometers at 100 Hz, in blocks of a tenth of a second.

Frames and samples lie in memory; every point has an accelerometer, four of them a camera. Load is processor time over
the time that the records last; the first part, in which kernels are made and templates learned, is not counted.
"""

import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.table import goal
from midspan.engine.axis import AxisFigures
from midspan.engine.camera import CameraChain, Target
from midspan.engine.guard import Guard, GuardSettings
from midspan.engine.merge import Merge
from midspan.engine.point import ACCELEROMETER, Point
from midspan.engine.sensors import CameraSensor
from midspan.engine.target_opening import Opening
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings
from midspan.records import NANOSECONDS, Arrival, Channel, Floats, Frame, Readings, Region, Source

CAMERAS, ACCELEROMETERS, CORES = 4, 20, 2
FRAME_HZ, SAMPLE_HZ, BLOCK_S = 30, 100, 0.1
WARM_UP_S, MEASURED_S = 20.0, 40.0
SHAPE, REGION, PERIOD = (480, 640), Region(256, 176, 128, 128), 60
M_PER_PX, NOISE_M_S2, SPEED_HZ = 1e-3, 3e-3, 1.0


def moved_px(time_s: Floats) -> Floats:
    """Translation (n,) down: a sine that begins again with the film."""
    return np.asarray(2.0 * np.sin(2 * np.pi * SPEED_HZ * time_s))


def film() -> list[NDArray[np.uint8]]:
    """PERIOD frames of a band-limited texture, with noise of 2 grey levels."""
    rng = np.random.default_rng(3)
    down, across = np.fft.fftfreq(SHAPE[0])[:, None], np.fft.rfftfreq(SHAPE[1])
    radius = np.hypot(down, across)
    spectrum = np.fft.rfft2(rng.standard_normal(SHAPE)) * np.exp(-0.5 * (radius / 0.07) ** 2) * (radius < 0.18)
    spectrum[0, 0] = 0.0
    spectrum *= 35.0 / np.fft.irfft2(spectrum, s=SHAPE).std()
    frames = []
    for y in moved_px(np.arange(PERIOD) / FRAME_HZ):
        image = 128 + np.fft.irfft2(spectrum * np.exp(-2j * np.pi * down * y), s=SHAPE)
        frames.append(np.clip(np.rint(image + rng.normal(0, 2.0, SHAPE)), 0, 255).astype(np.uint8))
    return frames


def point(first: Frame | None) -> Point:
    """A point with an accelerometer, and a camera whose reference is `first`."""
    sensors, channels = {}, ()
    if first is not None:
        chain = CameraChain(first, [Target(REGION)], Opening("registration"))
        channels = (Channel("camera", Source.CAMERA, 1.0 / M_PER_PX),)
        sensors["camera"] = CameraSensor("camera", chain, [[0]], ["y"])
    moved_m = 2.0 * M_PER_PX / np.sqrt(2.0)
    variance = (moved_m * (2 * np.pi * SPEED_HZ) ** 2) ** 2 + NOISE_M_S2**2
    density = NOISE_M_S2**2 / SAMPLE_HZ
    figures = AxisFigures(0.0, variance, SPEED_HZ, -1.0, 1.0, moved_m=moved_m, noise_density=density)
    merge = Merge([ACCELEROMETER, *sensors], lateness_s=0.5)
    return Point(merge, Guard(GuardSettings(SAMPLE_HZ, (figures,))), sensors, Estimator(EstimatorSettings(channels)))


def main() -> None:
    pictures = film()
    points = [point(Frame(0, pictures[0]) if k < CAMERAS else None) for k in range(ACCELEROMETERS)]
    rng, pushes = np.random.default_rng(1), []
    speed = 2 * np.pi * SPEED_HZ
    samples, frames = round(SAMPLE_HZ * BLOCK_S), round(FRAME_HZ * BLOCK_S)
    for block in range(round((WARM_UP_S + MEASURED_S) / BLOCK_S)):
        number = block * samples + np.arange(samples)
        at = number / SAMPLE_HZ
        for k, one in enumerate(points):
            noise = rng.normal(0, NOISE_M_S2, samples)
            value = (noise - M_PER_PX * speed**2 * moved_px(at))[:, None]
            arrivals = [Arrival(ACCELEROMETER, block, Readings(number * (NANOSECONDS // SAMPLE_HZ), value))]
            for j in range(frames * block, frames * (block + 1)) if k < CAMERAS else ():
                seen = Frame(round(j * NANOSECONDS / FRAME_HZ), pictures[j % PERIOD], j)
                arrivals.append(Arrival("camera", j, seen))
            for arrival in arrivals:
                begun = time.process_time()
                one.push(arrival)
                if block * BLOCK_S >= WARM_UP_S:
                    pushes.append(time.process_time() - begun)
    busy = sum(pushes)
    print(f"{len(pushes)} pushes in {MEASURED_S:g} s of records: {busy:.2f} s of processor time")
    goal("load of the cores", 100.0 * busy / MEASURED_S / CORES, 15.0, unit="%")
    goal("longest push, processor time", 1e3 * max(pushes), 20.0, unit="ms")
    goal("99.9 % of pushes within, processor time", 1e3 * float(np.quantile(pushes, 0.999)), 20.0, unit="ms")
