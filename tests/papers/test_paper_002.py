"""The radar paper (Ma, Choi, Yang and Sohn) from beat signal to rows, its steps in plain NumPy and SciPy."""

import json

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, filtfilt

from midspan.cli.main import run
from midspan.simulate.motion.motion import Sines
from midspan.simulate.radar.signal import Reflector
from midspan.sinks.metadata import partner
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest
from plain_filters import double_integral, regularised_filters
from radar_recordings import PLATE, PROFILE, Case, true_mm, write

FACTOR, RANGE_M, SPEED_OF_LIGHT_M_S = 1.27, 3.4, 299792458.0
WALL, RAIL = Reflector(RANGE_M, 900.0, ratio=1 / FACTOR, azimuth_rad=0.2), Reflector(1.1, 1500.0, ratio=0.0)
# 22 mm at 1 Hz: 138 mm/s of the structure and 109 of the range, beyond the 97 where plain unwrapping fails.
MOTION = Sines(np.array([0.022, 1e-3]), np.array([1.0, 2.7]), phase_rad=np.array([0.3, 1.1]))
CASE = Case((WALL, RAIL, PLATE), seed=4, frames=2200, motion=MOTION)
PHASE_PER_M = 4.0 * np.pi * PROFILE.start_frequency_hz / SPEED_OF_LIGHT_M_S
EDGE_S = 1.0


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    """The folder, in which the command has estimated with the paper's order of 101."""
    folder = write(tmp_path_factory.mktemp("radar") / "recording", CASE, "[fusion]\nhalf_window = 50")
    assert run(["estimate", str(folder), "--method", "fir", "--literal", "--quiet"]) == 0
    return folder, json.loads(partner(folder / "result.csv").read_text())


def unwrapped(phase, acceleration, step_s):
    """Equations 12 to 15, as a loop: the phase (n,) next to the one that two steps and the acceleration predict."""
    out = [phase[0], phase[0] + np.angle(np.exp(1j * (phase[1] - phase[0])))]
    for k in range(2, len(phase)):
        expected = 2.0 * out[-1] - out[-2] + PHASE_PER_M * step_s**2 * acceleration[k - 1]
        out.append(phase[k] + 2.0 * np.pi * np.round((expected - phase[k]) / (2.0 * np.pi)))
    return np.array(out)


def factor_by_trial(moved, felt, rate_hz):
    """Figure 5: that from 0.5 to 2 of least difference above 0.5 Hz, without the ends, where the filter settles."""
    b, a = butter(4, 0.5, "highpass", fs=rate_hz)
    seen, wanted = (filtfilt(b, a, one - one.mean())[400:-400] for one in (moved, felt))
    factors = np.arange(0.5, 2.0005, 0.001)
    return factors[np.argmin([np.mean((factor * seen - wanted) ** 2) for factor in factors])]


def test_the_whole_system_is_the_papers_steps_in_plain_numpy(estimated):
    folder, reported = estimated
    radar = reported["calibration"]["radar"]
    time, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    source = open_radar(folder / "adc_data.bin", RadarRequest(config=folder / "radar.cfg"))
    profiles = np.concatenate([block.phasors for block in source.profiles()])
    # The paper has one clock; ours is that of the recording.
    frame_s = source.times_ns() / 1e9 + CASE.offset_s
    level = np.interp(frame_s, time, value - value.mean())
    # First receiver, the whole bin of the wall, start frequency. The range's acceleration is the structure's over the
    # factor, which the first pass does not know.
    phase = np.angle(profiles[:, 0, round(RANGE_M / PROFILE.bin_m)])
    felt = double_integral(frame_s, level)
    factor = factor_by_trial(unwrapped(phase, level, 0.01) / PHASE_PER_M, felt, 100.0)
    moved = factor * unwrapped(phase, level / factor, 0.01) / PHASE_PER_M
    assert radar["literal"]
    assert radar["target_range_m"] == pytest.approx(RANGE_M, abs=PROFILE.bin_m)
    assert radar["conversion_factor"] == pytest.approx(factor, rel=0.01)
    assert radar["time_offset_s"] == pytest.approx(CASE.offset_s, abs=1e-3)
    # 3 Hz by an accuracy of 0.97: three periods in the window (docs/methods.md; the paper prints no cut-off).
    weight = np.sqrt(0.03 / 0.97) * (2.0 - 2.0 * np.cos(2.0 * np.pi * 3.0 * 0.01))
    slow, fast = regularised_filters(50, weight, 0.01)
    raised = CubicSpline(frame_s, moved)(time)
    plain = np.convolve(raised, slow / slow.sum(), "same") + np.convolve(value - value.mean(), fast, "same")
    table = np.genfromtxt(folder / "result.csv", delimiter=",", names=True, dtype=None, encoding=None)
    inner = (table["time_s"] > frame_s[0] + EDGE_S) & (table["time_s"] < frame_s[-1] - EDGE_S)
    found, expected = table["displacement_mm"][inner], 1e3 * np.interp(table["time_s"][inner], time, plain)
    difference = (found - found.mean()) - (expected - expected.mean())
    assert np.std(difference) < 0.01 * np.std(expected)
    # The paper's delay, what the spline between frames looks ahead, and two samples for stamps that are not even.
    assert reported["delay_s"] == pytest.approx(0.5 + 5.5 * 0.01 + 0.02, abs=6e-3)
    # Equations 12 to 15 were needed: plain unwrapping loses cycles.
    assert np.max(np.abs(np.unwrap(phase) / PHASE_PER_M - moved / factor)) > 5e-3


def test_the_whole_system_is_as_near_to_the_truth_as_published(estimated):
    folder, _ = estimated
    table = np.genfromtxt(folder / "result.csv", delimiter=",", names=True, dtype=None, encoding=None)
    inner = slice(200, -200)
    error = (table["displacement_mm"] - true_mm(folder, table["time_s"]))[inner]
    # Below 0.4 mm in its worst test, a wall at an angle; the motion here is 15.6 mm rms.
    assert np.std(error) < 0.4
