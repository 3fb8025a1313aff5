"""A recording's radar as printed in the paper: target and factor by trial, aided unwrapping, literal FIR."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import midspan
from midspan.cli.main import run
from midspan.papers.printed.radar_phase import grid_factor, printed_change
from midspan.settings.stored.calibration import load_calibration
from midspan.simulate.motion.motion import Sines
from midspan.simulate.radar.signal import Reflector
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest
from radar_recordings import PLATE, PROFILE, Case, true_mm, write

LITERAL = {"method": "fir", "literal": True}
WALL, FACTOR = Reflector(3.4, 900.0, ratio=1 / 1.27, azimuth_rad=0.2), 1.27
RAIL = Reflector(1.1, 1500.0, ratio=0.0)
CASE = Case((WALL, RAIL, PLATE), seed=1, rms_m=1e-3)


@pytest.fixture(scope="module")
def walled(tmp_path_factory):
    """Folder, calibration and result of the printed chain on a wall at an angle and a rail that moves along."""
    folder = write(tmp_path_factory.mktemp("literal") / "capture", CASE)
    recording = midspan.open_recording(folder, fusion=LITERAL)
    calibration = midspan.calibrate(recording)
    return folder, calibration, midspan.estimate(recording, calibration)


def change_by_hand(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) in s and range change (n,) in m: first receiver, whole bin, start frequency, plainly unwrapped.

    At 1 mm rms the range moves by less than the 97 mm/s from which plain unwrapping fails.
    """
    source = open_radar(folder / "adc_data.bin", RadarRequest(config=folder / "radar.cfg"))
    profiles = np.concatenate([block.phasors for block in source.profiles()])
    phase = np.unwrap(np.angle(profiles[:, 0, round(3.4 / PROFILE.bin_m)]))
    return source.times_ns() / 1e9, (phase - phase[0]) * 299792458.0 / (4 * np.pi * PROFILE.start_frequency_hz)


def test_target_and_factor_are_those_of_the_grid_on_plain_arrays(walled) -> None:
    folder, calibration, _ = walled
    frame_s, change = change_by_hand(folder)
    time_s, acceleration = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    level = np.interp(frame_s + CASE.offset_s, time_s, acceleration)
    # The calibration leaves half a second at the ends out, for the clock's offset.
    inner = slice(50, -50)
    by_hand = grid_factor(change[inner], level[inner], 100.0)
    best = calibration.radar.best
    assert calibration.radar.literal
    assert best.place_bin == round(3.4 / PROFILE.bin_m)
    # One step of the grid is 0.001.
    assert best.conversion_factor == pytest.approx(by_hand.conversion_factor, abs=3e-3)
    assert best.noise_m == pytest.approx(by_hand.error_m, rel=0.1)
    # The printed carrier is the start frequency, so that the factor is lower by its ratio to the one in the middle.
    assert best.conversion_factor == pytest.approx(FACTOR * 77e9 / PROFILE.carrier_hz, rel=0.02)
    others = [item for item in calibration.radar.targets if not item.used]
    assert others
    assert all("least error E" in item.reason and item.target.noise_m > best.noise_m for item in others)


def test_the_displacement_is_the_printed_one_and_within_what_the_paper_reaches(walled) -> None:
    folder, calibration, result = walled
    error = result.displacement_mm - true_mm(folder, result.time_s)
    # Its worst test, a wall at an angle, is below 0.4 mm; here chirp, wall and air are ideal.
    assert np.sqrt(np.mean(error**2)) < 0.1
    (measured,) = result.measured
    frame_s, change = change_by_hand(folder)
    moved = np.interp(measured.time_ns / 1e9 - calibration.radar.offset.value_s, frame_s, change)
    expected = calibration.radar.best.conversion_factor * (moved - moved[0])
    # The radar's displacement is factor times plain phase, nothing taken out or smoothed; stamps are whole ns.
    np.testing.assert_allclose(measured.value_m, expected, atol=1e-8)
    assert any("as printed" in text for text in result.warnings)
    assert not any("end of the grid" in text for text in result.warnings)


def test_the_midspan_way_is_nearer_to_the_truth(walled) -> None:
    folder, _, result = walled
    recording = midspan.open_recording(folder, fusion={"method": "fir"})
    own = midspan.estimate(recording, midspan.calibrate(recording))
    errors = [np.std(one.displacement_mm - true_mm(folder, one.time_s)) for one in (own, result)]
    assert errors[0] < errors[1]


def test_a_stored_calibration_gives_the_same_result(walled, tmp_path) -> None:
    folder, calibration, result = walled
    assert json.loads(calibration.save(tmp_path).read_text())["radar"]["literal"] is True
    again = midspan.estimate(midspan.open_recording(folder, fusion=LITERAL), load_calibration(tmp_path))
    np.testing.assert_allclose(again.displacement_mm, result.displacement_mm, atol=1e-9)


def test_a_calibration_of_the_other_kind_is_refused(walled, tmp_path, capsys) -> None:
    folder = tmp_path / "capture"
    shutil.copytree(walled[0], folder)
    file = walled[1].save(tmp_path)
    for more in ([], ["--method", "fir"]):
        assert run(["estimate", str(folder), "-c", str(file), "--quiet", *more]) == 2
        reported = capsys.readouterr().err
        assert "fusion.literal = true, this estimate has fusion.literal = false" in reported
    assert run(["calibrate", str(folder), "--quiet"]) == 0
    asked = ["estimate", str(folder), "-c", str(folder / "calibration.json"), "--quiet", "--literal", "--method", "fir"]
    assert run(asked) == 2
    assert "fusion.literal = false, this estimate has fusion.literal = true" in capsys.readouterr().err


@pytest.mark.parametrize("factor", [-1.6, 3.0])
def test_a_factor_that_the_grid_does_not_hold_is_reported(tmp_path, factor) -> None:
    folder = write(tmp_path, Case((Reflector(3.4, 900.0, ratio=1 / factor), PLATE), frames=1600))
    calibration = midspan.calibrate(midspan.open_recording(folder, fusion=LITERAL))
    assert calibration.radar.best.conversion_factor in (0.5, pytest.approx(2.0))
    reported = [text for text in calibration.warnings if "end of the grid" in text]
    assert len(reported) == 1
    assert "0.5 to 2" in reported[0]
    assert "negative" in reported[0]
    # Nobody knows the factor then: the band is as wide as the displacement itself.
    assert calibration.radar.relative_std == pytest.approx(1.0)


def test_a_window_shorter_than_the_high_pass_needs_is_refused(tmp_path) -> None:
    folder = write(tmp_path, Case((WALL, PLATE), frames=1000))
    with pytest.raises(midspan.DataError, match=r"at least 12 s.*it is 9\.\d"):
        midspan.calibrate(midspan.open_recording(folder, fusion=LITERAL))


def test_frames_that_never_arrived_are_no_measurements(tmp_path) -> None:
    # 512 bytes a frame: one packet touches 3 or 4 frames, through which the prediction goes on within the cycle. (Over
    # eleven its √6 of noise loses one, for good: that is the printed way.)
    folder = write(tmp_path, Case((WALL, PLATE), seed=1, rms_m=1e-3, lost=(500,)))
    result = midspan.estimate(midspan.open_recording(folder, fusion=LITERAL))
    missing = ~np.isfinite(result.measured[0].value_m)
    assert 3 <= np.count_nonzero(missing) <= 4
    assert np.std(result.displacement_mm - true_mm(folder, result.time_s)) < 0.1


def test_the_printed_unwrapping_follows_motion_that_plain_unwrapping_loses() -> None:
    # 20 mm at 1 Hz, from a standstill: 126 mm/s, where plain unwrapping at 77 GHz and 100 frames/s ends at 97 mm/s.
    motion, time_s = Sines(np.array([0.02]), np.array([1.0]), phase_rad=np.pi / 2), np.arange(1000) / 100.0
    unit = 4 * np.pi * 77e9 / 299792458.0
    true = motion.displacement(time_s)
    z = np.exp(1j * unit * true)
    z[:3] = np.nan
    found = printed_change(z, motion.acceleration(time_s), period_s=0.01, phase_per_m=unit)
    assert np.all(np.isnan(found[:3]))
    np.testing.assert_allclose(found[3:], true[3:] - true[3], atol=1e-9)
    plain = np.unwrap(np.angle(z[3:])) / unit
    assert np.max(np.abs(plain - plain[0] - found[3:])) > 1e-3


def test_an_unwrapping_that_ran_away_is_reported_and_its_band_holds_the_error(tmp_path) -> None:
    # Hidden for two seconds: the phase is noise, and the printed prediction goes on with whatever speed that leaves.
    wall = Reflector(3.4, 900.0, ratio=1 / 1.27, blocked=((14.0, 16.0),))
    folder = write(tmp_path, Case((wall, PLATE), seed=4))
    recording = midspan.open_recording(folder, fusion=LITERAL, calibration={"window_s": (0.0, 14.0)})
    result = midspan.estimate(recording)
    error = result.displacement_mm - true_mm(folder, result.time_s)
    later = result.time_s > 18.0
    assert np.max(np.abs(error[later])) > 100.0
    assert any("ran away" in text for text in result.warnings)
    assert np.mean(np.abs(error[later]) < 1.96 * result.displacement_std_mm[later]) > 0.9
