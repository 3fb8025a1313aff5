"""Results and references through files."""

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.evaluate.result_file import compare, read_reference, read_result
from midspan.records import Source, Status, nanoseconds
from midspan.sinks.table import ResultTable
from midspan.sinks.write import write_result
from midspan.sources.accelerometer import text

SUFFIXES = [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms", ".mseed", ".uff"]
TIME_NS = nanoseconds(1.25 + np.arange(1500) / 100.0)
TIME_S = TIME_NS / 1e9


def motion_mm(t):
    return 2.0 * np.sin(2 * np.pi * 0.7 * t) + 0.5 * np.cos(2 * np.pi * 3.1 * t)


def write(path):
    count = len(TIME_NS)
    columns = {
        "time_s": TIME_S,
        "displacement_mm": motion_mm(TIME_S) + 0.1,
        "displacement_std_mm": np.full(count, 0.2),
        "velocity_mm_s": np.zeros(count),
        "source": np.full(count, Source.CAMERA, dtype=np.uint8),
        "status": np.full(count, Status.TRACKING, dtype=np.uint8),
    }
    write_result(path, ResultTable(columns=columns, time_ns=TIME_NS, metadata={}))
    return path


@pytest.fixture(name="reference")
def reference_file(tmp_path):
    t = np.arange(2000) / 100.0
    path = tmp_path / "laser.csv"
    np.savetxt(path, np.column_stack((t, motion_mm(t))), delimiter=",", header="time_s,displacement_mm", comments="")
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_of_a_result_comes_back_with_its_band_and_exact_times(suffix, tmp_path):
    stored = read_result(write(tmp_path / f"result{suffix}"))
    np.testing.assert_array_equal(stored.series.time_ns, TIME_NS)
    # CSV keeps nine decimals of a millimetre, 1e-12 m.
    np.testing.assert_allclose(stored.series.value, 1e-3 * (motion_mm(TIME_S) + 0.1), atol=1e-12)
    np.testing.assert_allclose(stored.band.std_m, 2e-4, atol=1e-12)


def test_a_result_is_read_once(tmp_path, monkeypatch):
    path, reads = write(tmp_path / "result.csv"), []
    real = text.read
    monkeypatch.setattr(text, "read", lambda path: reads.append(path) or real(path))
    assert len(read_result(path).series.value) > 0
    assert reads == [path]


def test_two_files_compare(tmp_path, reference):
    found = compare(write(tmp_path / "result.csv"), reference)
    # At the same instants the spline returns the samples, written with 18 digits.
    assert found.bias_mm == pytest.approx(0.1, abs=1e-8)
    assert found.rmse_without_bias_mm == pytest.approx(0.0, abs=1e-8)
    assert found.coverage_95 == 1.0
    assert found.count == 1500
    assert set(found.to_dict()) >= {"rmse_mm", "bias_mm", "largest_error_mm", "correlation", "lag_s"}
    assert "error_mm" not in found.to_dict()


def test_the_reference_may_be_a_recording(tmp_path, reference):
    folder = tmp_path
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\n[displacement]\nfile = "d.csv"\n'
        f'[reference]\nfile = "{reference.name}"\ntime = "time_s"\nvalue = "displacement_mm"\nunit = "mm"\n'
    )
    found = compare(write(tmp_path / "result.h5"), folder)
    assert found.bias_mm == pytest.approx(0.1, abs=1e-8)
    with pytest.raises(UsageError, match=r"reference\.unit"):
        read_reference(folder, "cm")


def test_a_recording_without_reference_is_refused(tmp_path):
    (tmp_path / "recording.toml").write_text('[accelerometer]\nfile = "a.csv"\n[displacement]\nfile = "d.csv"\n')
    with pytest.raises(DataError, match=r"no \[reference\]"):
        read_reference(tmp_path)


def test_a_unit_wins_and_its_absence_is_reported(tmp_path, reference):
    t = np.arange(2000) / 100.0
    bare = tmp_path / "bare.csv"
    np.savetxt(bare, np.column_stack((t, motion_mm(t) / 10.0)), delimiter=",", header="time_s,level", comments="")
    result = write(tmp_path / "result.csv")
    assert compare(result, bare, unit="cm").bias_mm == pytest.approx(0.1, abs=1e-8)
    assumed = compare(result, bare)
    first, second = assumed.notes
    assert first == "bare.csv: no unit in the file; mm assumed."
    assert "the displacement is 10 times the reference. Check the units" in second
    assert assumed.reference_peak_to_peak_mm == pytest.approx(assumed.peak_to_peak_mm / 10.0, rel=1e-9)


def test_missing_files_and_files_without_displacement_are_refused(tmp_path, reference):
    with pytest.raises(DataError, match=r"nothing\.csv"):
        read_result(tmp_path / "nothing.csv")
    pixels = tmp_path / "track.csv"
    pixels.write_text("time_s,x_px,y_px\n0,1,2\n1,2,3\n2,3,5\n")
    with pytest.raises(UsageError, match="value must name the channel of displacement"):
        compare(pixels, reference)


def both_axes(path):
    """A result along y with the second axis x, which moves half as far."""
    columns = {
        "time_s": TIME_S,
        "displacement_mm": motion_mm(TIME_S),
        "displacement_std_mm": np.full(len(TIME_NS), 0.2),
        "displacement_x_mm": 0.5 * motion_mm(TIME_S),
        "displacement_std_x_mm": np.full(len(TIME_NS), 0.1),
    }
    write_result(path, ResultTable(columns=columns, time_ns=TIME_NS, metadata={}))
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_second_axis_comes_back_from_every_format(suffix, tmp_path):
    stored = read_result(both_axes(tmp_path / f"result{suffix}"), axis="x")
    np.testing.assert_allclose(stored.series.value, 0.5e-3 * motion_mm(TIME_S), atol=1e-12)
    np.testing.assert_allclose(stored.band.std_m, 1e-4, atol=1e-12)


def test_a_reference_of_one_axis_is_not_taken_for_the_second(tmp_path, reference):
    result = both_axes(tmp_path / "result.csv")
    assert compare(result, reference, axis="y").rmse_mm == pytest.approx(0.0, abs=1e-8)
    with pytest.raises(DataError, match=r"laser\.csv: has displacement_mm but no column displacement_x_mm"):
        compare(result, reference, axis="x")
    # Any other column is what the user says it is.
    t = np.arange(2000) / 100.0
    level = tmp_path / "level.csv"
    np.savetxt(level, np.column_stack((t, 0.5 * motion_mm(t))), delimiter=",", header="time_s,level", comments="")
    assert compare(result, level, unit="mm", axis="x").rmse_mm == pytest.approx(0.0, abs=1e-8)


def test_a_recording_along_one_axis_is_no_reference_for_the_other(tmp_path, reference):
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\ndirection = "y"\n'
        f'[reference]\nfile = "{reference.name}"\ntime = "time_s"\nvalue = "displacement_mm"\nunit = "mm"\n'
    )
    result = both_axes(tmp_path / "result.csv")
    assert compare(result, tmp_path, axis="y").rmse_mm == pytest.approx(0.0, abs=1e-8)
    with pytest.raises(DataError, match=r"displacement along y; .* column displacement_x_mm"):
        compare(result, tmp_path, axis="x")
