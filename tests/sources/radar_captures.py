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
# Settings as mmWave Studio saves them: 60.25 GHz, 65 MHz/µs, 4 MHz, 200 samples from 6 µs on, 14 bits, 20 Hz, 7 frames.
STUDIO = {
    "mmWaveDevice": "IWR6843",
    "mmWaveDevices": [{
        "rfConfig": {
            "rlChanCfg_t": {"rxChannelEn": "0x7", "txChannelEn": "0x5"},
            "rlAdcOutCfg_t": {"fmt": {"b2AdcBits": 1, "b2AdcOutFmt": 1}},
            "rlProfiles": [{"rlProfileCfg_t": {
                "profileId": 0, "startFreqConst_GHz": 60.25, "idleTimeConst_usec": 42.25, "adcStartTimeConst_usec": 6.0,
                "rampEndTime_usec": 57.75, "freqSlopeConst_MHz_usec": 65.0, "numAdcSamples": 200,
                "digOutSampleRate": 4000.0,
            }}],
            "rlChirps": [
                {"rlChirpCfg_t": {"chirpStartIdx": k, "chirpEndIdx": k, "profileId": 0, "txEnable": mask}}
                for k, mask in enumerate(("0x1", "0x4", "0x1", "0x4"))
            ],
            "rlFrameCfg_t": {
                "chirpStartIdx": 0, "chirpEndIdx": 3, "numLoops": 1, "numFrames": 7, "framePeriodicity_msec": 50.0,
            },
        },
        "rawDataCaptureConfig": {"rlDevDataFmtCfg_t": {"iqSwapSel": 1, "chInterleave": 1}},
    }],
}  # fmt: skip


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
