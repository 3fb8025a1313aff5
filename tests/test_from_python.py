"""midspan from Python: what a notebook shows, paths in place of records, and wrong arguments in words."""

import re
from pathlib import Path

import numpy as np
import pytest

import midspan
from recording_edits import set_keys


@pytest.fixture(scope="module")
def known(footbridge: Path) -> tuple[midspan.Calibration, midspan.Result]:
    """Calibration and result of a path alone."""
    calibration = midspan.calibrate(str(footbridge))
    return calibration, midspan.estimate(footbridge, calibration)


@pytest.mark.usefixtures("undrawn")
def test_the_section_of_the_contract_runs_on_paths(
    footbridge: Path, known: tuple[midspan.Calibration, midspan.Result], tmp_path: Path
) -> None:
    _, result = known
    recording = midspan.open_recording(footbridge)
    by_record = midspan.estimate(recording, calibration=midspan.calibrate(recording), method="smoother")
    np.testing.assert_array_equal(by_record.displacement_mm, result.displacement_mm)
    frame = result.to_pandas()
    assert frame.index.name == "time_s"
    assert list(frame.columns) == ["displacement_mm", "displacement_std_mm", "velocity_mm_s", "source", "status"]
    assert result.save(tmp_path / "result.parquet") == tmp_path / "result.parquet"
    assert result.report(tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    compared = midspan.compare(result, str(footbridge / "truth.csv"), unit="mm")
    of_file = midspan.compare(tmp_path / "result.parquet", footbridge / "truth.csv", unit="mm", align="zero+lag")
    # The file holds the same rows, to the digit.
    assert of_file.plain.rmse_mm == pytest.approx(compared.rmse_mm, rel=1e-6)
    assert of_file.align == "zero+lag"


def test_a_plot_is_a_figure_of_pyplot_that_a_script_can_show(
    known: tuple[midspan.Calibration, midspan.Result],
) -> None:
    from matplotlib import pyplot

    before = pyplot.get_fignums()
    figure = known[1].plot()
    (number,) = set(pyplot.get_fignums()) - set(before)
    assert pyplot.figure(number) is figure
    pyplot.close(figure)


def test_track_takes_a_path_and_plain_numbers(footbridge: Path, tmp_path: Path) -> None:
    found = midspan.track(str(footbridge / "camera.mkv"), roi=(16, 16, 57, 57), every=4)
    assert repr(found) == f"Tracked({len(found.track.time_ns)} frames, 0 lost, roi 16, 16, 57, 57 px, registration)"
    frame = found.to_pandas()
    np.testing.assert_array_equal(frame["y_px"].to_numpy(), found.track.y_px)
    assert found.save(tmp_path / "t.csv").is_file()


def test_records_show_themselves_in_a_line(footbridge: Path, known: tuple[midspan.Calibration, midspan.Result]) -> None:
    calibration, result = known
    assert calibration.camera is not None
    scale = calibration.camera.scale
    shown = repr(calibration)
    match = re.search(r"camera (\S+) ± (\S+) mm/px along y, clock offset \S+ ± \S+ ms", shown)
    assert match is not None
    # Five and two digits are shown.
    assert float(match[1]) == pytest.approx(1e3 * scale.value_m_per_px, rel=1e-4)
    assert float(match[2]) == pytest.approx(1e3 * scale.variance**0.5, rel=0.05)
    for text in (shown, repr(result), repr(midspan.open_recording(footbridge))):
        assert "\n" not in text
        assert len(text) < 250
    assert re.search(r"Result\('.*': \S+ … \S+ mm ± \S+ mm, \d+ rows from \S+ to \S+ s, smoother\)", repr(result))
    assert "accel.csv" in repr(midspan.open_recording(footbridge))


def test_a_notebook_shows_tables_and_escapes_names(
    footbridge_copy: Path, known: tuple[midspan.Calibration, midspan.Result]
) -> None:
    text = (footbridge_copy / "recording.toml").read_text(encoding="utf-8")
    named = re.sub(r'^name = ".*"', 'name = "<b>7 & 8</b>"', text, flags=re.MULTILINE)
    (footbridge_copy / "recording.toml").write_text(named, encoding="utf-8")
    page = midspan.open_recording(footbridge_copy)._repr_html_()
    assert "&lt;b&gt;7 &amp; 8&lt;/b&gt;" in page
    assert "<td>camera.mkv</td>" in page
    assert "mm/px" in known[0]._repr_html_()
    shown = known[1]._repr_html_()
    assert shown.startswith(f"<p><b>{known[1].verdict}</b></p>")
    assert '<img src="data:image/png;base64,' in shown
    assert "mm/px" in shown
    assert "smoother" in shown


def test_a_recording_without_the_camera_of_the_first_kind_shows_its_own(gnss: Path) -> None:
    shown = repr(midspan.calibrate(gnss))
    assert "displacement noise" in shown
    assert "clock offset" in shown


WRONG = {
    "open_recording: number": lambda folder: midspan.open_recording(5),
    "open_recording: nothing": lambda folder: midspan.open_recording(""),
    "open_recording: section": lambda folder: midspan.open_recording(folder, camera=5),
    "calibrate: number": lambda folder: midspan.calibrate(5),
    "calibrate: none": lambda folder: midspan.calibrate(None),
    "estimate: list": lambda folder: midspan.estimate([folder]),
    "estimate: calibration": lambda folder: midspan.estimate(folder, calibration=5),
    "estimate: method": lambda folder: midspan.estimate(folder, method=5),
    "estimate: no such method": lambda folder: midspan.estimate(folder, method="kalmann"),
    "compare: result": lambda folder: midspan.compare(5, folder),
    "compare: reference": lambda folder: midspan.compare(folder / "truth.csv", None),
    "compare: unit": lambda folder: midspan.compare(folder / "truth.csv", folder / "truth.csv", unit=5),
    "compare: align": lambda folder: midspan.compare(folder / "truth.csv", folder / "truth.csv", align=5),
    "load_calibration": lambda folder: midspan.load_calibration(5),
    "track: source": lambda folder: midspan.track(5),
    "track: roi": lambda folder: midspan.track(folder, roi=5),
    "track: roi of three": lambda folder: midspan.track(folder, roi=(1, 2, 3)),
    "track: tracker": lambda folder: midspan.track(folder, tracker="lucas-kanade"),
    "track: every": lambda folder: midspan.track(folder / "camera.mkv", every=0),
    "track: rate": lambda folder: midspan.track(folder / "camera.mkv", rate_hz="10"),
    "write_report: result": lambda folder: midspan.write_report(5, "x.html"),
    "choose_region": lambda folder: midspan.choose_region(5),
    "choose_region: arrays": lambda folder: midspan.choose_region([np.zeros((64, 64))]),
    "open_tracker: frame": lambda folder: midspan.open_tracker("template", np.zeros((64, 64)), (0, 0, 32, 32)),
    "smooth": lambda folder: midspan.smooth(np.zeros(5), np.zeros(5)),
    "push": lambda folder: midspan.KalmanFilter().push(5),
    "calibrate_scale": lambda folder: midspan.calibrate_scale(5, 0.5),
    "calibrate_noise": lambda folder: midspan.calibrate_noise(5, 0.5),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_argument_is_a_usage_error_with_rule_and_value(footbridge: Path, case: str) -> None:
    with pytest.raises(midspan.UsageError) as caught:
        WRONG[case](footbridge)
    assert "must be" in str(caught.value)


@pytest.mark.parametrize(
    "call",
    [
        lambda result: result.save(5),
        lambda result: result.report(None),
        lambda result: result.plot(5),
        lambda result: result.save("x.doc"),
    ],
)
def test_a_wrong_argument_of_a_result_is_one_too(call, known: tuple[midspan.Calibration, midspan.Result]) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(midspan.UsageError, match="must be"):
        call(known[1])


def test_a_method_of_the_call_wins_over_the_file(footbridge_copy: Path) -> None:
    set_keys(footbridge_copy, "fusion", method="kalman")
    set_keys(footbridge_copy, "camera", roi=[16, 16, 57, 57])
    assert midspan.estimate(footbridge_copy).method == "kalman"
    assert midspan.estimate(footbridge_copy, method="lag").method == "lag"
