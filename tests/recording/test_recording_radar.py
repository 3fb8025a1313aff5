"""A recording with a radar, from its files to millimetres: factor, clock, error band, outages, other sensors together
with."""

import json

import h5py
import numpy as np
import pytest

import midspan
from midspan.errors import UntrustedError, UsageError
from midspan.fusion.methods import METHODS
from midspan.radar.frames import RadarFrames, even_places, without_holes
from midspan.recording.inspect import inspect_recording
from midspan.records import Source, Status
from midspan.settings.stored.calibration import load_calibration
from midspan.simulate.motion.motion import Sines, Window, random_motion
from midspan.simulate.radar.signal import Reflector
from plain_data import assert_plain
from radar_recordings import PLATE, Case, true_mm, write
from recording_edits import set_keys
from repeats import slow

WALL, PIER = Reflector(3.4, 900.0, ratio=1 / 1.27, azimuth_rad=0.2), Reflector(6.1, 700.0, ratio=-1 / 1.6)
HEAD_ON = Reflector(2.2, 900.0, ratio=1.0)
CASES = {
    "two targets": Case((WALL, PIER, PLATE), seed=0),
    "head-on wall, force balance": Case((HEAD_ON, PLATE), seed=5, offset_s=0.04, noise_m_s2=1e-4),
}
FACTORS = {"two targets": (1.27, -1.6), "head-on wall, force balance": (1.0,)}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Folder, calibration and result of each case."""
    found = {}
    for name, case in CASES.items():
        folder = write(tmp_path_factory.mktemp("radar") / "capture", case)
        recording = midspan.open_recording(folder)
        calibration = midspan.calibrate(recording)
        found[name] = (folder, calibration, midspan.estimate(recording, calibration))
    return found


def error_mm(folder, result):
    return result.displacement_mm - true_mm(folder, result.time_s)


@pytest.mark.parametrize("name", CASES)
def test_factor_and_clock_lie_within_three_of_their_standard_deviations(recordings, name) -> None:
    radar, factors = recordings[name][1].radar, FACTORS[name]
    assert len(radar.used) == len(factors)
    for target in radar.used:
        true = min(factors, key=lambda factor: abs(factor - target.conversion_factor))
        assert abs(target.conversion_factor - true) < 3 * target.conversion_factor_std
        # The start frequency of the ramp instead of the middle of the window would be 1 % off.
        assert abs(target.conversion_factor / true - 1) < 0.005
    assert abs(radar.offset.value_s - CASES[name].offset_s) < 3 * np.sqrt(radar.offset.variance) < 2e-4


def test_the_result_is_plain_data(recordings):
    for _, _, result in recordings.values():
        assert_plain(result)
        assert result.radar.targets


@pytest.mark.parametrize("name", CASES)
def test_the_error_is_micrometres_and_the_band_holds_it(recordings, name) -> None:
    folder, _, result = recordings[name]
    error = error_mm(folder, result)
    # One frame is known to 8 to 16 µm of displacement; the zero is the first one, a single draw: two deviations.
    assert np.sqrt(np.mean(error**2)) < 0.032
    assert np.std(error) < 0.005
    # All rows share the zero, which is one draw: two deviations of it.
    assert np.sqrt(np.mean((error / result.displacement_std_mm) ** 2)) < 2.0
    assert set(result.to_pandas()["source"]) == {"radar"}
    assert set(result.to_pandas()["status"]) == {"tracking"}


@pytest.mark.parametrize("method", ["kalman", "fir", *slow(*sorted({*METHODS} - {"kalman", "fir"}))])
def test_every_method_is_better_than_the_radar_alone(recordings, method) -> None:
    folder, calibration, result = recordings["two targets"]
    (alone,) = result.measured
    apart = 1e3 * alone.value_m - true_mm(folder, alone.time_ns / 1e9)
    recording = midspan.open_recording(folder)
    fused = error_mm(folder, midspan.estimate(recording, calibration, method=method))
    # Not counting the zero, which all share; the first seconds of a filter are its start-up. At the frames' rate the
    # first of the two stages takes nothing off the radar's noise.
    worse = 1.02 if method == "two-stage-fir" else 1.0
    assert np.nanstd(fused[300:]) < worse * np.nanstd(apart[300:])


def test_the_calibration_is_written_with_its_promised_keys_and_read_back_alike(recordings, tmp_path) -> None:
    folder, calibration, result = recordings["two targets"]
    tree = json.loads(calibration.save(tmp_path).read_text())["radar"]
    assert tree["conversion_factor"] == pytest.approx(1.27, rel=1e-3)
    assert tree["target_range_m"] == pytest.approx(3.4, abs=0.02)
    assert {"conversion_factor_std", "time_offset_s", "time_offset_std_s"} <= set(tree)
    read = load_calibration(tmp_path)
    again = midspan.estimate(midspan.open_recording(folder), read)
    np.testing.assert_allclose(again.displacement_mm, result.displacement_mm, atol=1e-9)
    np.testing.assert_allclose(again.displacement_std_mm, result.displacement_std_mm, rtol=1e-6)


def test_a_damaged_section_names_its_key(recordings, tmp_path) -> None:
    _, calibration, _ = recordings["two targets"]
    file = calibration.save(tmp_path)
    whole = json.loads(file.read_text())
    for change, words in (
        ({"conversion_factor": 0.0}, r"radar\.conversion_factor = 0\.0: must not be 0"),
        ({"carrier_hz": None}, r"radar\.carrier_hz = None: must be"),
        ({"targets": []}, "radar: targets must hold a target in use"),
        ({"channels": 3}, "weights for 3 channels"),
    ):
        file.write_text(json.dumps({**whole, "radar": {**whole["radar"], **change}}))
        with pytest.raises(midspan.DataError, match=words):
            load_calibration(file)


def test_turning_the_accelerometer_turns_the_factor_and_the_displacement(tmp_path) -> None:
    folder = write(tmp_path, Case((HEAD_ON, PLATE), seed=2, sign=-1.0, frames=2000))
    recording = midspan.open_recording(folder)
    calibration = midspan.calibrate(recording)
    assert calibration.radar.best.conversion_factor == pytest.approx(-1.0, rel=0.005)
    assert np.std(error_mm(folder, midspan.estimate(recording, calibration))) < 0.01


def test_outages_are_reported_and_ridden_through_by_the_target_that_is_left(tmp_path) -> None:
    wall = Reflector(3.4, 900.0, ratio=1 / 1.27, blocked=((8.0, 14.0),))
    # 512 bytes a frame: 20 packets hold 56 frames.
    folder = write(tmp_path, Case((wall, PIER, PLATE), seed=3, lost=tuple(range(500, 520))))
    result = midspan.estimate(midspan.open_recording(folder, calibration={"window_s": (14.2, 25.0)}))
    error = error_mm(folder, result)
    hidden = (result.time_s > 8.2) & (result.time_s < 13.8)
    assert np.sqrt(np.mean(error[hidden] ** 2)) < 0.02
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.9
    kinds = {event.kind for event in result.events}
    assert {"blocked", "lost frames"} <= kinds
    assert "new datum" not in kinds
    blocked = [event for event in result.events if event.kind == "blocked" and "3.4" in event.text]
    assert blocked[0].time_ns / 1e9 == pytest.approx(8.0, abs=0.03)
    # What never arrived cannot be tracked.
    first = 500 * 1456 / 512 * 0.01 + 0.083
    empty = (result.time_s > first + 0.2) & (result.time_s < first + 0.4)
    assert np.all(result.estimate.status[empty] == Status.COASTING)


def test_an_outage_that_loses_the_cycle_declares_a_new_datum_and_widens_the_band(tmp_path) -> None:
    wall = Reflector(3.4, 900.0, ratio=1 / 1.27, blocked=((11.0, 17.0),))
    folder = write(tmp_path, Case((wall, PLATE), seed=4))
    result = midspan.estimate(midspan.open_recording(folder, calibration={"window_s": (0.0, 11.0)}))
    error, std = error_mm(folder, result), result.displacement_std_mm
    before, after = result.time_s < 10.5, result.time_s > 17.5
    assert np.sqrt(np.mean(error[before] ** 2)) < 0.015
    assert "new datum" in {event.kind for event in result.events}
    assert np.all(np.abs(error[after]) < 3 * std[after])
    assert np.median(std[after]) > 20 * np.median(std[before])
    # The level alone is unknown: the motion about it is as sharp as before.
    assert np.std(error[after]) < 0.02


def test_a_structure_at_rest_is_refused_with_what_speaks_against_the_target(tmp_path) -> None:
    folder = write(tmp_path, Case((WALL, PLATE), rms_m=1e-9, frames=1500))
    with pytest.raises(UntrustedError, match="No fixed target to calibrate"):
        midspan.calibrate(midspan.open_recording(folder))


def test_a_single_tone_leaves_the_clock_ambiguous_and_is_refused(tmp_path) -> None:
    tone = Sines(np.array([3e-3]), np.array([2.0]))
    folder = write(tmp_path, Case((WALL, PLATE), motion=tone, frames=1500))
    with pytest.raises(UntrustedError, match="clock offset is ambiguous"):
        midspan.calibrate(midspan.open_recording(folder))
    # Half a period is 0.25 s: a smaller search leaves one answer.
    found = midspan.calibrate(midspan.open_recording(folder, calibration={"max_offset_s": 0.12}))
    assert found.radar.best.conversion_factor == pytest.approx(1.27, rel=0.005)


def test_a_wanted_range_chooses_the_target_next_to_it_or_is_refused(recordings) -> None:
    folder = recordings["two targets"][0]
    found = midspan.calibrate(midspan.open_recording(folder, radar={"target_range_m": 6.0}))
    assert [target.conversion_factor for target in found.radar.used] == [pytest.approx(-1.6, rel=0.005)]
    with pytest.raises(UsageError, match=r"radar.target_range_m = 9: must be within 0.5 m of a target"):
        midspan.calibrate(midspan.open_recording(folder, radar={"target_range_m": 9.0}))


def test_a_calibration_of_another_radar_is_refused(recordings) -> None:
    from dataclasses import replace

    folder, calibration, _ = recordings["two targets"]
    for change, words in (({"carrier_hz": 60e9}, "carrier of 60 GHz"), ({"channels": 4}, "4 channels")):
        other = replace(calibration, radar=replace(calibration.radar, **change))
        with pytest.raises(UsageError, match=words):
            midspan.estimate(midspan.open_recording(folder), other)
    with pytest.raises(UsageError, match="no radar part"):
        midspan.estimate(midspan.open_recording(folder), replace(calibration, radar=None))


def test_a_slow_sensor_beside_the_radar_is_brought_to_its_zero(recordings, tmp_path) -> None:
    import shutil

    folder = shutil.copytree(recordings["two targets"][0], tmp_path / "both")
    time = np.arange(0.5, 25.0, 0.2)
    height = true_mm(folder, time) + 123_000 + np.random.default_rng(0).normal(0, 0.5, len(time))
    np.savetxt(folder / "gnss.csv", np.column_stack((time, height)), delimiter=",", header="time_s,height", comments="")
    with (folder / "recording.toml").open("a") as file:
        file.write('\n[displacement]\nfile = "gnss.csv"\nunit = "mm"\n')
    # The gain as it is: this sensor would tell it to 2 %.
    set_keys(folder, "accelerometer", estimate_scale=False)
    result = midspan.estimate(midspan.open_recording(folder))
    assert np.sqrt(np.mean(error_mm(folder, result) ** 2)) < 0.015
    assert Source.RADAR in result.estimate.source
    # The zero is one draw that all rows share.
    assert np.sqrt(np.mean((error_mm(folder, result) / result.displacement_std_mm) ** 2)) < 2.0


def test_a_target_hidden_in_the_calibration_window_does_not_enter_its_noise(tmp_path) -> None:
    wall = Reflector(3.4, 900.0, ratio=1 / 1.27, blocked=((6.0, 9.0),))
    folder = write(tmp_path, Case((wall, PLATE), seed=6))
    calibration = midspan.calibrate(midspan.open_recording(folder))
    assert any("longest unobstructed part, 15" in line for line in calibration.warnings)
    target = calibration.radar.best
    assert abs(target.conversion_factor - 1.27) < 3 * target.conversion_factor_std < 0.005
    # The noise of a frame at 10 dB a sample of 64 and two receivers, with the window's loss: 8 µm.
    assert 1e3 * target.noise_m == pytest.approx(0.0095, rel=0.2)


def test_absent_frames_leave_their_places_empty_and_holes_are_turned_with_the_other_channels() -> None:
    period = 10_000_000
    time_ns = np.array([0, 1, 2, 5, 6], dtype=np.int64) * period + np.array([0, 3, -2, 1, 0])
    assert even_places(time_ns).tolist() == [0, 1, 2, 5, 6]
    phase = np.array([0.0, 0.4, 0.8, 2.0, 2.4])
    z = np.exp(1j * phase)[:, None, None] * np.array([1.0, 2j])[None, :, None] * np.ones((1, 1, 3))
    valid = np.ones((5, 2), dtype=bool)
    valid[2, 1] = False
    whole = without_holes(RadarFrames(time_ns, z.astype(np.complex64), valid))
    assert len(whole.time_ns) == 7
    np.testing.assert_allclose(whole.phasors[2, 1], 2j * np.exp(0.8j), atol=1e-6)
    np.testing.assert_allclose(whole.phasors[[0, 1, 5, 6], 0, 0], np.exp(1j * phase[[0, 1, 3, 4]]), atol=1e-6)


def test_a_clock_that_runs_apart_is_corrected_before_anything_is_unwrapped(tmp_path) -> None:
    # Slow-time I/Q of one wall for 130 s; true time = the radar's · (1 + 60 ppm) + 50 ms; half a second is absent.
    rng, factor, carrier_hz = np.random.default_rng(3), 1.3, 77.7e9
    motion = Window(random_motion((0.5, 4.0), 4e-3, rng=rng, lines=100), start_s=0.5, ramp_s=2.0)
    own_s = np.delete(np.arange(13_000) / 100, slice(6000, 6050))
    true_s = own_s * (1 + 60e-6) + 0.05
    phase = 4 * np.pi * carrier_hz / 299_792_458.0 * motion.displacement(true_s) / factor
    z = 20 * np.exp(1j * phase) + rng.normal(size=len(phase)) + 1j * rng.normal(size=len(phase))
    with h5py.File(tmp_path / "radar.h5", "w") as file:
        file["iq"], file["time_s"] = z.astype(np.complex64), own_s
        file["carrier_hz"], file["range_m"] = carrier_hz, np.array([5.0])
    time = np.arange(0, 130.5, 0.01)
    value = motion.acceleration(time) + rng.normal(0, 2e-3, len(time))
    np.savetxt(tmp_path / "accel.csv", np.column_stack((time, value)), delimiter=",", header="time_s,a", comments="")
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[radar]\nfile = "radar.h5"\n'
    )
    recording = midspan.open_recording(tmp_path)
    calibration = midspan.calibrate(recording)
    assert calibration.radar.best.conversion_factor == pytest.approx(factor, rel=2e-3)
    # Clocks that run apart would look like seven times the accelerometer's noise.
    assert calibration.noise_std_m_s2 == pytest.approx(2e-3, rel=0.2)
    result = midspan.estimate(recording, calibration)
    assert any("ppm" in line and "corrected" in line for line in result.warnings)
    error = result.displacement_mm - 1e3 * (motion.displacement(result.time_s) - motion.displacement(true_s[:1]))
    # 8 ms at 60 mm/s would be 0.2 mm rms.
    assert np.std(error) < 0.01
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.9


def test_inspect_tells_chirp_range_and_peaks(recordings) -> None:
    tree = inspect_recording(midspan.open_recording(recordings["two targets"][0]))
    radar = tree["radar"]
    assert radar["frames"] == 2500
    assert radar["rate_hz"] == pytest.approx(100.0)
    assert radar["range_resolution_m"] == pytest.approx(299_792_458.0 / (2 * 64.985e12 * 64 / 6e6), rel=1e-9)
    assert radar["limit_speed_mm_s"] == pytest.approx(96.4, abs=0.1)  # a quarter of a wavelength a frame
    ranges = [peak["range_m"] for peak in radar["peaks"]]
    assert min(abs(place - 3.4) for place in ranges) < 0.02
    assert min(abs(place - 6.1) for place in ranges) < 0.02
    assert tree["overlap"]["streams"] == ["accelerometer", "radar"]


def test_an_acconeer_recording_is_inspected_beside_an_accelerometer(data_folder, tmp_path) -> None:
    file = data_folder / "acconeer" / "recorded_data_corner-reflector.h5"
    if not file.is_file():
        pytest.skip(f"real data are absent: {file}")
    time = np.arange(0.0, 3.0, 0.01)
    value = np.random.default_rng(0).normal(0.0, 1e-3, len(time))
    np.savetxt(tmp_path / "accel.csv", np.column_stack((time, value)), delimiter=",", header="time_s,a", comments="")
    (tmp_path / "recording.toml").write_text(
        f'[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[radar]\nfile = "{file}"\n'
    )
    radar = inspect_recording(midspan.open_recording(tmp_path))["radar"]
    assert radar["carrier_hz"] == 60.5e9
    # Two subsweeps see the reflector; it stands at 0.45 m.
    assert any(abs(peak["range_m"] - 0.45) < 0.02 for peak in radar["peaks"])
