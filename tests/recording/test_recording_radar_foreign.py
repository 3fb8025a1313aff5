"""A radar's calibration from another recording: a factor or a clock that is wrong here is refused by every method."""

import json

import h5py
import numpy as np
import pytest

import midspan
from midspan.simulate.motion.motion import random_motion
from repeats import slow

CARRIER_HZ, FACTOR = 77.7e9, 1.3


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """20 s of slow-time I/Q of one wall at 26 dB, its clock that of the accelerometer."""
    folder = tmp_path_factory.mktemp("wall")
    rng = np.random.default_rng(11)
    motion = random_motion((0.5, 3.0), 3e-3, rng=rng)
    own_s = np.arange(2000) / 100
    phase = 4 * np.pi * CARRIER_HZ / 299_792_458.0 * motion.displacement(own_s) / FACTOR
    z = 20 * np.exp(1j * phase) + (rng.normal(size=2000) + 1j * rng.normal(size=2000)) / np.sqrt(2)
    with h5py.File(folder / "radar.h5", "w") as file:
        file["iq"], file["time_s"] = z.astype(np.complex64), own_s
        file["carrier_hz"], file["range_m"] = CARRIER_HZ, np.array([5.0])
    time = np.arange(-1, 21, 0.01)
    value = motion.acceleration(time) + rng.normal(0, 2e-3, len(time))
    np.savetxt(folder / "accel.csv", np.column_stack((time, value)), delimiter=",", header="time_s,a", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[radar]\nfile = "radar.h5"\n', encoding="utf-8"
    )
    return folder


@pytest.fixture(scope="module")
def known(wall):
    return midspan.calibrate(midspan.open_recording(wall)).save(wall / "known.json").read_text(encoding="utf-8")


def given(known, wall, **changed):
    """The calibration with the factor and the clock offset of all targets changed."""
    tree = json.loads(known)
    for part in (tree["radar"], *tree["radar"]["targets"]):
        part["conversion_factor"] *= changed.get("factor", 1.0)
        part["time_offset_s"] += changed.get("late_s", 0.0)
    (wall / "given.json").write_text(json.dumps(tree), encoding="utf-8")
    return midspan.load_calibration(wall / "given.json")


@pytest.mark.parametrize("method", ["smoother", "kalman", "fir", *slow("lag", "adaptive-kalman", "two-stage-fir")])
def test_a_foreign_factor_or_clock_is_refused_by_every_method_and_the_right_one_is_not_reported(wall, known, method):
    recording = midspan.open_recording(wall)
    for changed, words in (
        ({"factor": 0.5}, "conversion_factor does not belong"),
        ({"late_s": 0.1}, r"its clock deviates by -(99\.\d|100)"),
    ):
        with pytest.raises(midspan.UntrustedError, match=words):
            midspan.estimate(recording, given(known, wall, **changed), method=method)
    right = midspan.estimate(recording, given(known, wall), method=method)
    assert not [line for line in right.warnings if "does not belong" in line]


def test_a_factor_that_is_a_tenth_off_is_reported_with_its_size(wall, known):
    # A method with a gate refuses it: a tenth of the motion is many times the noise.
    found = midspan.estimate(midspan.open_recording(wall), given(known, wall, factor=1.1), method="fir")
    (reported,) = [line for line in found.warnings if "conversion_factor does not belong" in line]
    assert reported.startswith("radar: its displacement is 1.1 ")
