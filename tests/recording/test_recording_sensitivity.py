"""The tolerance of the accelerometer's sensitivity in calibration, band, result and report."""

import json

import numpy as np
import pytest

import midspan
from lively_recordings import SENSORS, Lively, write
from midspan.cli.main import run
from midspan.recording.not_in_band import SENSITIVITY
from recording_edits import append, read_columns, set_keys
from repeats import slow

STD = 0.02
SCALES = {"camera": "scale_mm_per_px", "infrared": "scale_mm_per_px", "radar": "conversion_factor"}
CASES = {
    "camera": Lively(duration_s=20.0, rms_m=2e-3),
    "infrared": Lively(duration_s=20.0, rms_m=2e-3),
    "radar": Lively(duration_s=15.0, rms_m=2e-3, rate_hz=50.0),
    "displacement": Lively(duration_s=25.0),
}


def said(not_in_band):
    """Whether the list names the accelerometer's sensitivity."""
    return any(SENSITIVITY in line for line in not_in_band)


@pytest.fixture(scope="module", params=["camera", "displacement", "radar", *slow("infrared")])
def known(request, tmp_path_factory):
    """Sensor, folder, and the calibrations without and with a given tolerance."""
    sensor = request.param
    more = "estimate_scale = true" if sensor == "displacement" else ""
    folder = write(tmp_path_factory.mktemp("tolerance") / sensor, CASES[sensor], sensor, more)
    without = midspan.calibrate(folder)
    set_keys(folder, "accelerometer", scale_std=STD)
    return sensor, folder, without, midspan.calibrate(folder)


def test_the_scales_deviation_holds_it_in_quadrature_in_the_file_too(known, tmp_path):
    sensor, _, without, tolerant = known
    file = tolerant.save(tmp_path / "calibration.json")
    key = SCALES.get(sensor, "scale")
    std = "scale_std_mm_per_px" if key == "scale_mm_per_px" else f"{key}_std"
    before, after = without.to_dict()[sensor], json.loads(file.read_text())[sensor]
    assert after[key] == before[key]
    assert after[std] == pytest.approx(np.hypot(before[std], STD * abs(before[key])), rel=1e-9)
    assert json.loads(file.read_text())["accelerometer"]["scale_std"] == STD
    assert midspan.load_calibration(file).accelerometer_scale_std == STD


@pytest.mark.parametrize(("method", "given"), [("smoother", False), ("kalman", True), *slow(("fir", False))])
def test_every_rows_variance_grows_by_its_share_of_the_displacement(known, method, given):
    _, folder, without, tolerant = known
    after = midspan.estimate(folder, tolerant if given else None, method=method)
    if given:
        # What the recording itself says of its accelerometer counts also with a calibration that knows nothing of it.
        other = midspan.estimate(folder, without, method=method)
        np.testing.assert_allclose(other.displacement_std_mm, after.displacement_std_mm, rtol=1e-9)
    set_keys(folder, "accelerometer", scale_std=0.0)
    before = midspan.estimate(folder, without if given else None, method=method)
    set_keys(folder, "accelerometer", scale_std=STD)
    more = after.estimate.variance_m2 - before.estimate.variance_m2
    # Without rows whose variance is raised to that of the zero, and those of fir that are the smoother's.
    own = before.displacement_std_mm > 1.001e3 * before.zero_std_m
    own &= (before.time_s > before.time_s[0] + 4.0) & (before.time_s < before.time_s[-1] - 4.0)
    assert np.mean(own) > 0.3
    # All of the displacement was scaled by the accelerometer, whichever sensor it rests on. The filter carries that as
    # a sensitivity, which the noise of the measurements disturbs: to some percent, and to (25 µm)² near 0.
    np.testing.assert_allclose(more[own], (STD * before.estimate.displacement_m[own]) ** 2, rtol=0.04, atol=6e-10)
    # Which measurements fir takes for outliers, and how it bridges between them, depends on the band: by less than a
    # tenth of it.
    moved = np.abs(after.displacement_mm - before.displacement_mm)
    assert np.max(moved / before.displacement_std_mm if "fir" in method else moved / 1e-3) < 0.1
    assert said(before.not_in_band)
    assert not said(after.not_in_band)


def test_an_accelerometer_that_reads_two_percent_too_much_is_held(tmp_path):
    case = CASES["camera"]
    folder = write(tmp_path / "off", case, "camera")
    table = read_columns(folder / "accel.csv")
    table[:, 1] *= 1.0 + STD
    np.savetxt(folder / "accel.csv", table, delimiter=",", header="time_s,accel", comments="", fmt="%.9f")
    inside = []
    for std in (0.0, STD):
        set_keys(folder, "accelerometer", scale_std=std)
        result = midspan.estimate(folder)
        error = result.displacement_mm - case.from_zero_mm(result.time_s)
        inside.append(np.mean(np.abs(error) < 1.96 * result.displacement_std_mm))
    # The error is one standard deviation of what is given, in every row.
    assert inside[0] < 0.5
    assert inside[1] > 0.95


def test_beside_metres_the_gain_is_estimated_and_its_tolerance_is_what_the_motion_must_beat(tmp_path):
    folder = write(tmp_path / "metres", CASES["displacement"], "displacement")
    assert not said(midspan.estimate(folder).not_in_band)
    estimated = midspan.calibrate(folder)
    assert 0.0 < estimated.accelerometer_scale_std < 0.01
    for std, kept in (
        (10.0 * estimated.accelerometer_scale_std, False),
        (0.1 * estimated.accelerometer_scale_std, True),
    ):
        set_keys(folder, "accelerometer", scale_std=std)
        found = midspan.calibrate(folder)
        assert (found.accelerometer_scale_std == std) is kept
        assert (found.accelerometer_scale == 1.0) is kept
    set_keys(folder, "accelerometer", scale_std=0.0, estimate_scale=False)
    assert said(midspan.estimate(folder).not_in_band)


@pytest.mark.usefixtures("undrawn")
def test_result_command_and_report_say_that_it_is_left_out(tmp_path, capsys):
    folder, reported = write(tmp_path / "told", CASES["radar"], "radar"), []
    for std in (0.0, STD):
        set_keys(folder, "accelerometer", scale_std=std)
        page, table = tmp_path / "report.html", tmp_path / "r.csv"
        assert run(["estimate", str(folder), "-o", str(table), "--report", str(page), "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        stored = json.loads(table.with_suffix(".json").read_text(encoding="utf-8"))
        assert document["not_in_band"] == stored["not_in_band"]
        reported.append(
            (
                said(stored["not_in_band"]),
                "accelerometer sensitivity: an error of 1 %" in page.read_text(encoding="utf-8"),
            )
        )
        assert not any("sensitivity" in line for line in stored["warnings"])
        page.unlink(), table.unlink(), table.with_suffix(".json").unlink()
    assert reported == [(True, True), (False, False)]


def test_a_gain_that_was_estimated_holds_for_the_camera_alone(tmp_path):
    case = Lively(duration_s=30.0, rms_m=2e-3, noise_m=0.05e-3)
    folder = write(tmp_path / "both", case, "camera")
    alone = (folder / "recording.toml").read_text(encoding="utf-8")
    append(folder, "[displacement]\n" + SENSORS["displacement"](folder, case, np.random.default_rng(9)))
    table = read_columns(folder / "accel.csv")
    table[:, 1] *= 1.05
    np.savetxt(folder / "accel.csv", table, delimiter=",", header="time_s,accel", comments="", fmt="%.9f")
    calibration = midspan.calibrate(folder)
    assert calibration.accelerometer_scale == pytest.approx(1.05, abs=4.0 * calibration.accelerometer_scale_std)
    (folder / "recording.toml").write_text(alone, encoding="utf-8")
    inside = {}
    for method in ("smoother", "fir"):
        result = midspan.estimate(folder, calibration, method=method)
        error = result.displacement_mm - case.from_zero_mm(result.time_s)
        inside[method] = np.mean(np.abs(error) < 1.96 * result.displacement_std_mm)
        if method == "smoother":
            # 5 % of the motion are 0.1 mm rms; the zero's error and the gain's deviation remain.
            assert np.std(error) < 0.01
    assert inside["smoother"] > 0.9
    assert inside["fir"] > 0.8
