"""Recordings with a displacement sensor in the camera's place: GNSS heights at 1 Hz."""

import shutil

import numpy as np
import pytest

import midspan
from midspan.errors import DataError, MidspanError, UntrustedError, UsageError
from midspan.records import Status
from recording_edits import error_mm, read_columns, set_keys, write_acceleration, write_displacement
from repeats import slow

NOISE_MM = 2.0


@pytest.fixture
def gnss_copy(gnss, tmp_path):
    folder = tmp_path / "gnss"
    shutil.copytree(gnss, folder)
    return folder


@pytest.fixture(scope="module")
def result(gnss):
    return midspan.estimate(midspan.open_recording(gnss))


def heights(folder):
    return read_columns(folder / "gnss.csv").T


def write_heights(folder, time, value):
    table = np.column_stack((time, value))
    np.savetxt(folder / "gnss.csv", table, delimiter=",", header="time_s,height", comments="", fmt="%.6f")


def tracking_error(folder, found):
    known = found.estimate.status == Status.TRACKING
    return error_mm(folder, found.time_s, found.displacement_mm)[known]


def test_fusion_is_much_better_than_the_sensor_alone_and_its_band_is_honest(gnss, result):
    error = error_mm(gnss, result.time_s, result.displacement_mm)
    # 2 mm of noise at 1 Hz and motion of 5 mm at 0.8 Hz, which 1 Hz cannot show at all.
    assert np.std(tracking_error(gnss, result)) < 0.5 * NOISE_MM
    assert abs(np.mean(error)) < 0.5 * NOISE_MM
    assert 0.88 < np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) <= 1.0
    assert 1e3 * result.calibration.displacement.noise_std_m == pytest.approx(NOISE_MM, rel=0.25)


def test_rows_without_heights_are_coasting_then_lost_and_say_prediction(result):
    table = result.to_pandas()
    # Heights are missing from 70 to 82 s and from 120 to 124 s.
    gap = table.loc[73.5:80.0]
    assert set(gap["status"].unique()) <= {"coasting", "lost"}
    assert set(gap["source"].unique()) == {"prediction"}
    assert set(table.loc[10.0:60.0, "status"].unique()) == {"tracking"}
    assert gap["displacement_std_mm"].max() > 2 * table.loc[10.0:60.0, "displacement_std_mm"].median()


def test_a_large_height_changes_the_level_and_nothing_else(gnss_copy, result):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, value + 123_456.0)
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    # With [displacement] alone the zero is that file's own. 123 m in double precision is exact to 2e-8 mm.
    np.testing.assert_allclose(found.displacement_mm - 123_456.0, result.displacement_mm, atol=1e-3)
    np.testing.assert_array_equal(found.estimate.status, result.estimate.status)


@pytest.mark.parametrize(("count", "size", "seed"), [(18, 50.0, 3), *slow((10, 1e6, 3), (5, 100.0, 3), (16, 50.0, 1))])
def test_outliers_do_little(count, size, seed, gnss_copy):
    time, value = heights(gnss_copy)
    rng = np.random.default_rng(seed)
    # Not within 4 s behind a gap, where nothing can tell the outlier from the structure: see the next test.
    settled = np.all(np.abs(time[:, None] - 2.0 - np.array([82.0, 124.0])) > 2.5, axis=1) & np.isfinite(value)
    hit = rng.choice(np.flatnonzero(settled)[5:-5], count, replace=False)
    value[hit] += size * rng.choice([-1.0, 1.0], count)
    write_heights(gnss_copy, time, value)
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    # A tenth of the measurements less may cost some 5 %; outliers that got through would cost several millimetres.
    assert np.std(tracking_error(gnss_copy, found)) < 0.75 * NOISE_MM
    assert 1e3 * found.calibration.displacement.noise_std_m == pytest.approx(NOISE_MM, rel=0.4)


def test_an_outlier_that_ends_a_gap_is_declared_and_recovered_from(gnss_copy):
    time, value = heights(gnss_copy)
    first = np.searchsorted(time, 82.0)
    value[first] -= 50.0
    write_heights(gnss_copy, time, value)
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    error = np.abs(error_mm(gnss_copy, found.time_s, found.displacement_mm))
    # After 12 s of acceleration alone 50 mm are likely; the following heights contradict. The gate waits 5 s before it
    # takes another level; nothing before the gap or long behind it may suffer.
    assert error[(found.time_s < 68.0) | (found.time_s > 95.0)].max() < 3 * NOISE_MM
    assert any(event.kind == "reacquired" for event in found.events) or error.max() < 10 * NOISE_MM


def test_the_clock_offset_of_the_sensor_is_found(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time - 0.2, value)
    set_keys(gnss_copy, "displacement", estimate_offset=True)
    offset = midspan.calibrate(midspan.open_recording(gnss_copy)).displacement.offset
    # Heights of 2 mm noise know the time of 5 mm at 0.8 Hz to 2/(5·2π·0.8·√90) = 8 ms.
    assert offset.value_s == pytest.approx(0.2, abs=0.03)
    assert np.sqrt(offset.variance) < 0.03


def test_the_noise_of_the_sensor_may_be_given_in_its_own_unit(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, 1e-3 * value)
    set_keys(gnss_copy, "displacement", unit="m", noise_std=0.002)
    calibration = midspan.calibrate(midspan.open_recording(gnss_copy))
    assert calibration.displacement.noise_std_m == pytest.approx(2e-3)


@pytest.mark.parametrize("wrong", ["other sign", "other unit", "static"])
def test_heights_that_contradict_the_accelerometer_are_refused(wrong, gnss_copy):
    time, value = heights(gnss_copy)
    if wrong == "other unit":
        set_keys(gnss_copy, "displacement", unit="m")
    else:
        write_heights(gnss_copy, time, -value if wrong == "other sign" else np.full_like(value, 12.0))
    with pytest.raises((UntrustedError, DataError)) as caught:
        midspan.estimate(midspan.open_recording(gnss_copy))
    assert "displacement" in str(caught.value)


def test_too_few_numbers_are_refused_however_many_rows_there_are(gnss_copy):
    time, value = heights(gnss_copy)
    value[10:] = np.nan
    write_heights(gnss_copy, time, value)
    with pytest.raises(MidspanError, match="at least 20"):
        midspan.estimate(midspan.open_recording(gnss_copy))


@pytest.mark.parametrize("estimate_offset", [True, *slow(False)])
def test_heights_of_the_wrong_sign_are_refused_with_that_reason(gnss_copy, estimate_offset):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, -value)
    set_keys(gnss_copy, "displacement", estimate_offset=estimate_offset)
    with pytest.raises(UntrustedError, match="sign is reversed"):
        midspan.calibrate(midspan.open_recording(gnss_copy))


def test_a_calibration_may_be_given_as_its_file(gnss, result, tmp_path):
    file = result.calibration.save(tmp_path / "calibration.json")
    again = midspan.estimate(midspan.open_recording(gnss), calibration=file)
    # A given calibration's scale is estimated: the rows differ by what the record tells of it, far within the band.
    apart = np.abs(again.displacement_mm - result.displacement_mm)
    assert np.all(apart < 0.1 * result.displacement_std_mm)


def test_frozen_heights_are_reported_and_left_out(gnss_copy, result):
    time, value = heights(gnss_copy)
    held = (time >= 30.0) & (time < 50.0)
    value[held] = value[held][0]
    write_heights(gnss_copy, time, value)
    found = midspan.estimate(midspan.open_recording(gnss_copy), result.calibration)
    (begun,) = (event for event in found.events if event.kind == "frozen")
    (ended,) = (event for event in found.events if event.kind == "released")
    assert begun.text in found.warnings
    # Five equal values are not judged yet; the last of them lies at 49 s.
    assert 33.5 < begun.time_ns / 1e9 < 38.5
    assert ended.time_ns / 1e9 == pytest.approx(49.0, abs=0.1)
    assert "20 values were frozen at" in ended.text
    # Without heights the rows coast after 2.5 intervals, and are lost after 10 s.
    last = begun.time_ns / 1e9
    assert set(found.to_pandas().loc[last + 2.5 : 48.0, "status"].unique()) <= {"coasting", "lost"}


def test_a_record_of_a_twentieth_of_a_second_is_fused(tmp_path):
    """A machine part: 200 Hz and 470 Hz, 0.1 mm, met 1000 times at 20 kHz."""
    rng = np.random.default_rng(1)
    amplitude, turning, phase = np.array([[0.1, 0.03], [400.0 * np.pi, 940.0 * np.pi], [0.0, 1.0]])

    def moved_mm(time, derivative=0):
        waves = np.sin(np.outer(time, turning) + phase)
        return waves @ (amplitude * (-(turning**2)) ** (derivative // 2))

    time, met = np.arange(10_000) / 2e5, np.arange(1000) / 2e4
    shaken = 1e-3 * moved_mm(time, 2) + rng.normal(0.0, 1.0, time.size)
    write_displacement(tmp_path, (time, shaken), (met, moved_mm(met) + rng.normal(0.0, 2e-3, met.size)))
    found = midspan.estimate(midspan.open_recording(tmp_path))
    error = found.displacement_mm - moved_mm(found.time_s)
    # Half of the sensor's noise of 2 µm; the band is 95 %.
    assert np.sqrt(np.mean(error**2)) < 1e-3
    assert np.mean(np.abs(error) < 1.96 * found.displacement_std_mm) > 0.9


def test_it_is_calibrated_in_the_window_that_is_given(gnss_copy):
    time, value = heights(gnss_copy)
    late = time > 60.0
    spoilt = value.copy()
    spoilt[late] += 30.0 * np.random.default_rng(0).standard_normal(np.count_nonzero(late))
    # What comes after the window has no effect on the calibration.
    set_keys(gnss_copy, "calibration", window_s=[0.0, 60.0])
    first = midspan.calibrate(gnss_copy)
    write_heights(gnss_copy, time, spoilt)
    second = midspan.calibrate(gnss_copy)
    assert second.displacement == first.displacement
    assert second.bias_m_s2 == first.bias_m_s2
    assert second.noise_std_m_s2 == first.noise_std_m_s2


def test_a_window_with_too_few_values_is_refused(gnss_copy):
    set_keys(gnss_copy, "calibration", window_s=[20.0, 30.5])
    with pytest.raises(UsageError, match=r"window_s = \[20.0, 30.5\]: must hold at least 20 values .* received 11"):
        midspan.calibrate(gnss_copy)


def test_a_column_that_is_constant_is_said_to_be_so(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, np.zeros_like(value))
    with pytest.raises(DataError, match="all values are 0 mm"):
        midspan.calibrate(gnss_copy)
    half = np.where(time < 5.0, value, 2.0)
    write_heights(gnss_copy, time, half)
    with pytest.raises(DataError, match=r"more are frozen .* and left out"):
        midspan.calibrate(gnss_copy)


def test_heights_at_the_end_of_the_range_are_left_out_and_called_clipped(gnss_copy):
    rng, time = np.random.default_rng(1), np.arange(0.0, 60.0, 0.01)
    tones = ((5e-3, 0.37, 0.3), (4e-3, 0.11, 1.0), (1e-3, 1.3, 2.0))
    motion = [sum(m * np.sin(2 * np.pi * f * t + p) for m, f, p in tones) for t in (time, time[::10])]
    value = sum(-m * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time + p) for m, f, p in tones)
    write_acceleration(gnss_copy, time, value + 5e-3 * rng.standard_normal(len(time)))
    heights_mm = 1e3 * motion[1] + 0.1 * rng.standard_normal(600)
    write_heights(gnss_copy, time[::10], np.clip(heights_mm, -7.0, 7.0))
    set_keys(gnss_copy, "displacement", noise_std=0.1)
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    assert found.calibration.displacement.high_m == pytest.approx(7e-3)
    assert any("values are clipped at" in line for line in found.warnings)
    assert {event.kind for event in found.events} <= {"clipped", "lost"}
    error = found.displacement_mm - 1e3 * np.interp(found.time_s, time, motion[0])
    # What is left out is bridged by the acceleration; a row in 2000 of normal errors is beyond 3.5 deviations.
    assert np.max(np.abs(error / found.displacement_std_mm)) < 5.0
    assert np.std(error) < 0.1


def test_a_gnss_receiver_has_its_usual_slow_error_unless_told_otherwise(gnss_copy):
    set_keys(gnss_copy, "displacement", noise_time_s=None)
    none = midspan.calibrate(midspan.open_recording(gnss_copy)).displacement
    set_keys(gnss_copy, "displacement", receiver="gnss")
    usual = midspan.calibrate(midspan.open_recording(gnss_copy))
    assert (none.slow_std_m, usual.displacement.slow_std_m, usual.displacement.slow_time_s) == (0.0, 3e-3, 100.0)
    assert sum("usual for GNSS receivers" in str(one) for one in usual.warnings) == 1
    set_keys(gnss_copy, "displacement", noise_time_s=0)
    assert midspan.calibrate(midspan.open_recording(gnss_copy)).displacement.slow_std_m == 0.0
