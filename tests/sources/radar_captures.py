"""Small radar captures for tests: words laid out by hand, apart from the package's own packing."""

from pathlib import Path

import numpy as np

# The chirp of paper-like short range with fewer samples, so that tests stay small.
CFG = """% Platform:xWR16xx
sensorStop
channelCfg {mask} 1 0
adcCfg {bits} {form}
adcbufCfg -1 {real} {swap} 1 1
profileCfg 0 77 7 6 60 0 0 64.985 1 {samples} 6000 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
frameCfg 0 0 {loops} {frames} 10 1 0
lvdsStreamCfg -1 {header} 1 0
sensorStart
"""
DEFAULTS = {"mask": 15, "bits": 2, "form": 1, "real": 0, "swap": 0, "samples": 64, "loops": 1, "frames": 0, "header": 0}


def settings(folder: Path, **changed: object) -> Path:
    """A settings file; keys of DEFAULTS change it."""
    path = folder / "radar.cfg"
    path.write_text(CFG.format(**{**DEFAULTS, **changed}))
    return path


def words_by_hand(cube: np.ndarray, order: str) -> np.ndarray:
    """Words of a cube (frames, chirps, receivers, samples) of whole numbers on two lanes, one loop for each place."""
    out = []
    for chirp in cube.reshape(-1, cube.shape[-1]):
        for first in range(0, len(chirp), 2):
            a, b = chirp[first], chirp[first + 1]
            group = {
                "IIQQ": (a.real, b.real, a.imag, b.imag),
                "QQII": (a.imag, b.imag, a.real, b.real),
                "IQIQ": (a.real, a.imag, b.real, b.imag),
                "QIQI": (a.imag, a.real, b.imag, b.real),
            }[order]
            out.extend(int(value) for value in group)
    return np.array(out, dtype="<i2")


def echoes(bins: tuple[float, ...], *, frames: int = 40, receivers: int = 4, samples: int = 64, seed: int = 0):
    """A cube of whole numbers with targets of amplitude 1000 at fractional bins and noise of 5 counts."""
    rng = np.random.default_rng(seed)
    n = np.arange(samples)
    cube = rng.normal(0, 5, (frames, 1, receivers, samples)) + 1j * rng.normal(0, 5, (frames, 1, receivers, samples))
    for place in bins:
        phase = rng.uniform(0, 2 * np.pi, (1, 1, receivers, 1))
        cube = cube + 1000 * np.exp(1j * (phase + 2 * np.pi * place * n / samples))
    return np.rint(cube.real) + 1j * np.rint(cube.imag)
