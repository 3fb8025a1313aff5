"""A calibration that was given: a scale of the camera that is not the recording's is refused or reported."""

import json
from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.calibration.scale_check import Sensed, apparent_scale, fitting
from midspan.records import Acceleration, Displacement, Source, nanoseconds
from midspan.simulate.scenarios.table import sideways
from repeats import slow

TIME, MET = np.arange(6000) / 100.0, np.arange(599) / 10.0 + 0.004


def inputs_motion(time, order=0):
    """Displacement (m) or, of order 2, acceleration (m/s²) at the times, s."""
    parts = ((2e-3, 0.6), (1e-3, 3.3))
    return sum((-1 if order else 1) * a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * time) for a, f in parts)


def inputs(seed, *, factor=1.0, amplitude=1.0, source=Source.CAMERA):
    """2 mm at 0.6 Hz with 1 mm at 3.3 Hz: 2 mm/s² of noise, 0.01 mm at 10 Hz."""
    rng = np.random.default_rng(seed)

    def motion(time, order):
        return amplitude * inputs_motion(time, order)

    acceleration = motion(TIME, 2) + 0.05 + rng.normal(0, 2e-3, len(TIME))
    value = factor * motion(MET, 0) + rng.normal(0, 1e-5, len(MET))
    sources = np.full(len(MET), source.value, dtype=np.uint8)
    measured = Displacement(nanoseconds(MET), value, np.full(len(MET), 1e-10), sources)
    block = Acceleration(nanoseconds(TIME), acceleration, np.full(len(TIME), 4e-8))
    return block, Sensed(source.word, source, measured)


def judged(given, along="", **more):
    """What is reported of one sensor."""
    acceleration, sensed = given
    return fitting(acceleration, [sensed], along, **more)


def changed(given, **fields):
    """The same with other fields of the measurements."""
    acceleration, sensed = given
    return acceleration, replace(sensed, measured=replace(sensed.measured, **fields))


@pytest.mark.parametrize("factor", [1.04, -1.0, *slow(1.0, 1.5, 0.7)])
def test_the_apparent_scale_is_the_factor_that_the_camera_is_wrong_by(factor):
    ratio = []
    for seed in range(12):
        found = apparent_scale(*inputs(seed, factor=factor))
        assert found.value == pytest.approx(factor, abs=4e-3)
        ratio.append((found.value - factor) / found.std)
    # Twelve draws: a deviation that is right within a third.
    assert 0.6 < np.std(ratio) < 1.6


def test_a_scale_that_is_right_or_nearly_so_is_not_reported_a_wrong_one_is_refused():
    assert judged(inputs(0)).warnings == judged(inputs(0, factor=1.003)).warnings == []
    for factor in (1.02, 1.04, 1.1):
        (text,) = judged(inputs(0, factor=factor), " along x").warnings
        reported = float(text.split("along x is ")[1].split(" ±")[0])
        assert reported == pytest.approx(factor, abs=4e-3)
        assert "does not belong to this recording; the error band includes the" in text
    for factor in (1.3, 0.7, -1.0):
        with pytest.raises(midspan.UntrustedError, match="does not belong to this recording"):
            judged(inputs(0, factor=factor))


def test_beside_another_sensor_less_is_refused_and_the_message_names_the_sensor():
    acceleration, right = inputs(7)
    _, wrong = inputs(8, factor=1.1)
    with pytest.raises(midspan.UntrustedError, match=r"left: its displacement is 1\.1"):
        fitting(acceleration, [right, replace(wrong, sensor="left")])
    reported = fitting(acceleration, [right, replace(inputs(8, factor=1.03)[1], sensor="left")])
    assert [line[:5] for line in reported.warnings] == ["left:"]
    # What it is off by goes into the band of this one alone, though both are cameras.
    assert reported.scale_std["camera"] == 0.0
    assert reported.scale_std["left"] == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("amplitude", [0.0, 1e-3, 1e-2])
@pytest.mark.parametrize("seed", [0, 1, *slow(2, 3, 4, 5)])
def test_a_quiet_record_says_nothing_of_the_scale(amplitude, seed):
    # What the accelerometer's noise integrates to follows no camera: it must not be taken for a scale of nought.
    assert judged(inputs(seed, amplitude=amplitude)).warnings == []


def test_outliers_and_missing_frames_do_not_hide_or_feign_a_wrong_scale():
    rng = np.random.default_rng(1)
    for factor in (1.0, 1.1):
        found = inputs(3, factor=factor)
        value = found[1].measured.value_m + np.where(rng.random(len(MET)) < 0.05, 5e-3, 0.0)
        value[rng.random(len(MET)) < 0.1] = np.nan
        scale = apparent_scale(*changed(found, value_m=value))
        assert scale.value == pytest.approx(factor, abs=0.02)


def late(seed, late_s, *, source, factor=1.0):
    """The measurements of `inputs` with stamps that are `late_s` too early."""
    found = inputs(seed, source=source, factor=factor)
    return changed(found, time_ns=found[1].measured.time_ns - round(1e9 * late_s))


@pytest.mark.parametrize("source", [Source.RADAR, Source.DISPLACEMENT])
def test_scale_and_clock_of_sensors_whose_clock_is_taken_from_the_calibration_are_both_found(source):
    ratio = []
    for seed in range(6):
        found = apparent_scale(*late(seed, 0.1, source=source, factor=1.5), 0.2)
        assert found.value == pytest.approx(1.5, abs=5e-3)
        assert found.late_s == pytest.approx(0.1, abs=1e-3)
        ratio.append((found.late_s - 0.1) / found.late_std_s)
    assert np.std(ratio) < 2.0
    # 2 mm at 0.6 Hz and 1 mm at 3.3 Hz a tenth of a second later: 2 a sin(w/20) each, as root mean square, times 1.5.
    change = [2e-3 * np.sin(np.pi * 0.6 * 0.1), 1e-3 * np.sin(np.pi * 3.3 * 0.1)]
    assert found.moved_m == pytest.approx(1.5 * np.sqrt(2.0) * np.hypot(*change), rel=0.03)


@pytest.mark.parametrize("source", [Source.RADAR, Source.DISPLACEMENT])
def test_a_clock_is_refused_where_it_moves_the_result_by_more_than_its_noise(source):
    # 15.6 mm/s rms and 0.01 mm of noise: a millisecond moves it by 1.6 deviations, 2 ms by 3, 5 ms by 8.
    for late_s, lines in ((0.0, 0), (1e-3, 0), (2e-3, 1)):
        assert len(judged(late(1, late_s, source=source), max_offset_s=0.2).warnings) == lines
    for late_s in (5e-3, -0.1):
        with pytest.raises(midspan.UntrustedError, match="its clock deviates by"):
            judged(late(1, late_s, source=source), max_offset_s=0.2)
    # What the calibration itself does not know is in the error band, and no contradiction.
    acceleration, sensed = late(1, 5e-3, source=source)
    assert fitting(acceleration, [replace(sensed, clock_std_s=2e-3)], max_offset_s=0.2).warnings == []


def test_a_factor_of_the_radar_that_is_half_is_refused():
    wrong = inputs(0, factor=0.5, source=Source.RADAR)
    with pytest.raises(midspan.UntrustedError, match="conversion_factor does not belong"):
        judged(wrong, max_offset_s=0.2)


@pytest.fixture(scope="module")
def site(simulated):
    return simulated("two axes", across=sideways)


@pytest.fixture(scope="module")
def known(site, tmp_path_factory):
    file = tmp_path_factory.mktemp("known") / "calibration.json"
    return json.loads(midspan.calibrate(midspan.open_recording(site)).save(file).read_text(encoding="utf-8"))


def with_scale(known, axis, factor, file):
    tree = json.loads(json.dumps(known))
    tree["camera"]["axes"][axis]["scale_mm_per_px"] *= factor
    if axis == tree["camera"]["axis"]:
        tree["camera"]["scale_mm_per_px"] *= factor
    file.write_text(json.dumps(tree), encoding="utf-8")
    return midspan.load_calibration(file)


@pytest.mark.parametrize(
    ("factor", "method"), [(-1.0, "smoother"), (0.7, "kalman"), *slow((1.5, "kalman"), (1.3, "smoother"))]
)
def test_a_wrong_scale_of_the_second_axis_leaves_it_out_and_the_first_stays(site, known, tmp_path, factor, method):
    recording = midspan.open_recording(site)
    wrong = with_scale(known, "x", factor, tmp_path / "wrong.json")
    found = midspan.estimate(recording, wrong, method=method)
    assert found.across is None
    assert any("The second axis x is left out" in line for line in found.warnings)
    truth = np.loadtxt(site / "truth.csv", delimiter=",", skiprows=1)
    error = found.displacement_mm - np.interp(found.time_s, truth[:, 0], truth[:, 1])
    # As with the right one: a frame of these cameras is good for 0.006 mm; `kalman` knows no later frames.
    assert np.std(error) < (0.025 if method == "kalman" else 0.006)


def test_a_scale_of_the_second_axis_that_is_somewhat_off_is_reported_and_the_right_one_is_not(site, known, tmp_path):
    recording = midspan.open_recording(site)
    reported = [
        [
            line
            for line in midspan.estimate(recording, given).warnings
            if "along x is" in line or "axis x is left" in line
        ]
        for given in (with_scale(known, "x", factor, tmp_path / "given.json") for factor in (1.0, 1.07))
    ]
    # Where most of its measurements contradict the acceleration it is left out instead, and that is reported as well.
    assert reported[0] == []
    assert len(reported[1]) == 1


@pytest.mark.parametrize("factor", [1.3, -1.0])
def test_a_wrong_scale_of_the_main_axis_is_refused(site, known, tmp_path, factor):
    wrong = with_scale(known, "y", factor, tmp_path / "wrong.json")
    with pytest.raises(midspan.UntrustedError, match="does not belong to this recording"):
        midspan.estimate(midspan.open_recording(site), wrong, method="kalman")
