"""Captures, slow-time I/Q and settings of radars."""

import json

import h5py
import numpy as np
from radar_captures import settings as demo_settings
from radar_captures import words_by_hand

from fuzz.world import (
    CARRIER_HZ,
    RECORDING,
    SPEED_OF_LIGHT_M_S,
    Seed,
    moved_m,
    recording,
)


def radar(write, file, lines=""):
    """A recording whose radar file is what `write` makes, or lies together with the settings that it makes."""

    def make(folder):
        named = file if file.endswith((".bin", ".h5", ".npy")) else "adc_data.bin"
        write(folder / named)
        recording(folder, f'\n[radar]\nfile = "{named}"\n{lines}\n')

    return make


def echoes(frames=60, receivers=4, samples=64):
    """A cube (frames, 1, receivers, samples) of whole numbers: a wall at bin 11.3 whose range follows the motion."""
    rng = np.random.default_rng(5)
    phase = 4 * np.pi * moved_m(np.arange(frames) / 100.0) * 78.8e9 / SPEED_OF_LIGHT_M_S
    turns = 2 * np.pi * 11.3 * np.arange(samples) / samples
    cube = 1000 * np.exp(1j * (phase[:, None, None, None] + turns + rng.uniform(0, 6, (1, 1, receivers, 1))))
    cube = cube + rng.normal(0, 5, cube.shape) + 1j * rng.normal(0, 5, cube.shape)
    return np.rint(cube.real) + 1j * np.rint(cube.imag)


def _capture(path):
    demo_settings(path.parent)
    path.write_bytes(words_by_hand(echoes(), "IIQQ").tobytes())


def _packets(path):
    demo_settings(path.parent)
    data = words_by_hand(echoes(), "IIQQ").tobytes()
    heads = ((number, start) for number, start in enumerate(range(0, len(data), 1456), start=1))
    parts = (
        number.to_bytes(4, "little") + start.to_bytes(6, "little") + data[start : start + 1456]
        for number, start in heads
    )
    path.write_bytes(b"".join(parts))


STUDIO = {
    "mmWaveDevice": "AWR1642",
    "mmWaveDevices": [{
        "rfConfig": {
            "rlChanCfg_t": {"rxChannelEn": "0xF", "txChannelEn": "0x1"},
            "rlAdcOutCfg_t": {"fmt": {"b2AdcBits": 2, "b2AdcOutFmt": 1}},
            "rlProfiles": [{"rlProfileCfg_t": {
                "profileId": 0, "startFreqConst_GHz": 77.0, "idleTimeConst_usec": 7.0, "adcStartTimeConst_usec": 6.0,
                "rampEndTime_usec": 60.0, "freqSlopeConst_MHz_usec": 64.985, "numAdcSamples": 64,
                "digOutSampleRate": 6000.0,
            }}],
            "rlChirps": [{"rlChirpCfg_t": {"chirpStartIdx": 0, "chirpEndIdx": 0, "profileId": 0, "txEnable": "0x1"}}],
            "rlFrameCfg_t": {
                "chirpStartIdx": 0, "chirpEndIdx": 0, "numLoops": 1, "numFrames": 0, "framePeriodicity_msec": 10.0,
            },
        },
        "rawDataCaptureConfig": {"rlDevDataFmtCfg_t": {"iqSwapSel": 0, "chInterleave": 1}},
    }],
}  # fmt: skip


def _studio(path):
    (path.parent / "radar.mmwave.json").write_text(json.dumps(STUDIO, indent=1))
    path.write_bytes(words_by_hand(echoes(), "IIQQ").tobytes())


def phasors(rate_hz=100.0, count=300):
    """Slow-time I/Q (frames, channels, bins) at CARRIER_HZ."""
    rng = np.random.default_rng(9)
    phase = 4 * np.pi * moved_m(np.arange(count) / rate_hz) * CARRIER_HZ / SPEED_OF_LIGHT_M_S
    z = np.exp(1j * phase)[:, None, None] * np.array([0.2, 1.0, 0.3]) * np.exp(1j * np.arange(2))[:, None]
    return (z + rng.normal(0, 0.01, z.shape) + 1j * rng.normal(0, 0.01, z.shape)).astype(np.complex64)


def _slow_hdf5(form):
    def write(path):
        z = phasors()
        with h5py.File(path, "w") as file:
            if form == "complex":
                file.create_dataset("iq", data=z, chunks=True, compression="gzip")
            elif form == "fields":
                fields = np.zeros(z.shape, dtype=[("real", "<f4"), ("imag", "<f4")])
                fields["real"], fields["imag"] = z.real, z.imag
                file["iq"] = fields
            else:
                file["i"], file["q"] = z.real, z.imag
            file.attrs["carrier_hz"], file.attrs["rate_hz"] = CARRIER_HZ, 100.0
            file["range_m"] = np.array([1.0, 1.5, 2.0])

    return write


def _a111(path):
    with h5py.File(path, "w") as file:
        file["mode"], file["data"] = "IQ", phasors()
        file["session_info"] = json.dumps({"range_start_m": 0.3, "step_length_m": 0.03})
        file["sensor_config_dump"] = json.dumps({"update_rate": 100.0})
        file["sample_times"] = 1.7e9 + np.arange(len(phasors())) / 100.0


def _acconeer(path):
    frames = np.zeros((60, 5, 3), dtype=[("real", "<i2"), ("imag", "<i2")])
    z = phasors(count=300)[:, 0].reshape(60, 5, 3) * 1000
    frames["real"], frames["imag"] = z.real, z.imag
    sensor = {
        "sweep_rate": 500.0, "frame_rate": 100.0, "continuous_sweep_mode": False,
        "subsweeps": [{"start_point": 80, "step_length": 8, "num_points": 3, "enable_tx": True}],
    }  # fmt: skip
    metadata = {"subsweep_data_offset": [0], "subsweep_data_length": [3], "base_step_length_m": 0.0025}
    with h5py.File(path, "w") as file:
        entry = file.create_group("sessions/session_0/group_0/entry_0")
        entry.create_dataset("result/frame", data=frames, chunks=(10, 5, 3), compression="gzip")
        entry["result/tick"] = np.arange(60, dtype=np.int64) * 10
        entry["metadata"], entry["sensor_id"] = json.dumps(metadata), 1
        file["sessions/session_0/session_config"] = json.dumps({"groups": [{"1": sensor}]})
        file["server_info"] = json.dumps({"ticks_per_second": 1000})


CFG = 'config = "radar.cfg"\n'
JSON = 'config = "radar.mmwave.json"\n'
RADARS = (
    Seed("dca1000", "radar bin", "adc_data.bin", radar(_capture, "adc_data.bin", CFG), commands=RECORDING),
    Seed("dca1000-packets", "radar bin", "adc_data.bin", radar(_packets, "adc_data.bin", CFG), commands=RECORDING),
    Seed("cfg", "radar cfg", "radar.cfg", radar(_capture, "radar.cfg", CFG), text=True, commands=RECORDING),
    Seed("mmwave-json", "radar json", "radar.mmwave.json", radar(_studio, "radar.mmwave.json", JSON), text=True,
         commands=RECORDING),
    Seed("slow-h5", "radar h5", "slow.h5", radar(_slow_hdf5("complex"), "slow.h5")),
    Seed("slow-h5-fields", "radar h5", "slow.h5", radar(_slow_hdf5("fields"), "slow.h5")),
    Seed("slow-h5-two", "radar h5", "slow.h5", radar(_slow_hdf5("two"), "slow.h5")),
    Seed("slow-npy", "radar npy", "slow.npy",
         radar(lambda path: np.save(path, phasors()), "slow.npy", "rate_hz = 100.0\ncarrier_hz = 60.5e9\n"),
         commands=RECORDING),
    Seed("a111", "radar Acconeer", "a111.h5", radar(_a111, "a111.h5"), commands=RECORDING),
    Seed("acconeer", "radar Acconeer", "acco.h5", radar(_acconeer, "acco.h5"), commands=RECORDING),
)  # fmt: skip
