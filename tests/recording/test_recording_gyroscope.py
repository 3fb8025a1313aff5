"""A camera whose box nods, with an inertial sensor in it: a gyroscope, gravity along the view, an inclinometer.

Tracks and readings are written from physics: a target at the distance D moves in the image by -f u / D + f θ where the
box moves down by u and turns by θ about the image's x axis; along the view the accelerometer reads g θ.
"""

import re

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import midspan
from midspan.errors import UntrustedError, UsageError
from midspan.recording.inspect import inspect_recording
from midspan.simulate.scenarios.write import write
from repeats import slow

GRAVITY, FOCAL_PX, MDEG = 9.80665, 5000.0, np.pi / 180e3
FINE_HZ, RATE_HZ, FRAMES_HZ = 1000.0, 100.0, 30.0
# A gyroscope of 0.005 °/s/√Hz with a bias of 0.2 °/s.
DENSITY, BIAS = np.radians(0.005), np.radians(0.2)


def band(rng, count, rate_hz, low_hz, high_hz, rms):
    """Noise (n,) of a band."""
    margin = int(20 * rate_hz)
    value = rng.normal(size=count + 2 * margin)
    value = sosfiltfilt(butter(2, [low_hz, high_hz], "bandpass", fs=rate_hz, output="sos"), value)[margin:-margin]
    return rms * value / np.std(value)


class Site:
    """A footbridge of 45 m at quarter span: a mode with its slope, walkers, a mount that tilts by some millidegrees."""

    def __init__(self, seed=0, length_s=80.0, nods=True):
        rng = np.random.default_rng(seed)
        self.rng, self.grid = rng, np.arange(int(length_s * FINE_HZ)) / FINE_HZ
        count = len(self.grid)
        mode = band(rng, count, FINE_HZ, 2.07, 2.13, 1e-3)
        self.u, self.angle = mode.copy(), nods * np.pi / 45.0 * mode
        for walker_s in (15.0, 45.0, 65.0):
            self.u -= 2e-3 * np.exp(-0.5 * ((self.grid - walker_s) / 5.0) ** 2)
            self.angle -= np.pi / 45.0 * 2e-3 * np.exp(-0.5 * ((self.grid - walker_s - 2.0) / 5.0) ** 2)
        self.angle += 5.0 * MDEG * np.sin(2.0 * np.pi * self.grid / 170.0 + rng.uniform(0.0, 6.0))
        self.angle += nods * band(rng, count, FINE_HZ, 3.45, 3.55, 1.5 * MDEG)
        self.at_s = np.arange(int(length_s * RATE_HZ)) / RATE_HZ
        self.seen_s = 0.005 + np.arange(int((length_s - 0.1) * FRAMES_HZ)) / FRAMES_HZ

    def at(self, value, time_s):
        return np.interp(time_s, self.grid, value)

    def write(self, folder, distances_m, noise_px, hidden_s=(0.0, 0.0), spoilt=lambda time_s, rate: rate):
        rng, count = self.rng, len(self.at_s)
        felt = self.at(np.gradient(np.gradient(self.u, self.grid), self.grid), self.at_s)
        rate = self.at(np.gradient(self.angle, self.grid), self.at_s)
        rate += BIAS + rng.normal(0.0, DENSITY * np.sqrt(RATE_HZ / 2.0), count)
        along = GRAVITY * self.at(self.angle, self.at_s) + band(rng, count, RATE_HZ, 1.0, 3.0, 1e-2)
        # 10 µg of slow error, as of a quiet accelerometer.
        along += band(rng, count, RATE_HZ, 0.005, 0.05, 1e-5 * GRAVITY) + rng.normal(0.0, 1e-3, count)
        rows = {
            "time_s": self.at_s,
            "ay": felt - GRAVITY + rng.normal(0.0, 1e-3, count),
            "az": along,
            "gx": np.degrees(spoilt(self.at_s, rate)),
            "pitch": np.degrees(self.at(self.angle, self.at_s)) + rng.normal(0.0, 1e-3, count),
        }
        write_table(folder / "box.csv", rows)
        columns = {"time_s": self.seen_s}
        hidden = (self.seen_s > hidden_s[0]) & (self.seen_s < hidden_s[1])
        for k, distance_m in enumerate(distances_m):
            moved = self.at(self.angle - self.u / distance_m, self.seen_s)
            y_px = FOCAL_PX * (moved - moved[0]) + rng.normal(0.0, noise_px, len(moved))
            if k:
                y_px[hidden] = np.nan
            end = f"_target{k + 1}" if k else ""
            columns |= {f"x_px{end}": rng.normal(0.0, noise_px, len(moved)), f"y_px{end}": y_px}
        write_table(folder / "track.csv", columns)
        return folder

    def error(self, result, span_s=(0.0, np.inf)):
        """Error (mm, n) since the first frame within a span, and 1.96 standard deviations of it."""
        time_s = result.time_s
        inner = (time_s > max(span_s[0], 5.0)) & (time_s < span_s[1])
        true_mm = 1e3 * (self.at(self.u, time_s) - self.at(self.u, self.seen_s[0]))
        return (result.displacement_mm - true_mm)[inner], 1.96 * result.displacement_std_mm[inner]


def write_table(file, columns):
    rows = np.column_stack(list(columns.values()))
    text = [",".join("" if np.isnan(value) else f"{value:.9g}" for value in row) for row in rows]
    file.write_text("\n".join([",".join(columns), *text]) + "\n")


BOX = '[accelerometer]\nfile = "box.csv"\ntime = "time_s"\nvalue_y = "ay"\nunit = "m/s^2"\n'
CAMERA = '[camera]\nfile = "track.csv"\ndirection = "y"\n[calibration]\nmax_offset_s = 0.1\n'
GYROSCOPE = '[gyroscope]\nfile = "box.csv"\ntime = "time_s"\nvalue_x = "gx"\nunit = "deg/s"\n'
INCLINOMETER = '[inclinometer]\nfile = "box.csv"\ntime = "time_s"\nvalue_x = "pitch"\nunit = "deg"\n'
LENS = "[camera.lens]\nmatrix = [5000.0, 5000.0, 0.0, 0.0]\ndistortion = [0.0, 0.0, 0.0, 0.0]\nsize = [1, 1]\n"


def estimated(folder, *parts, **how):
    (folder / "recording.toml").write_text("".join(parts))
    return midspan.estimate(folder, **how)


def with_gravity(box):
    return box.replace('value_y = "ay"\n', 'value_y = "ay"\nvalue_z = "az"\n')


# Bounds of the smoother by simulation with known tilt's prior: 0.05 and 0.14 mm; ignored: 0.13 and 0.31 mm where such a
# target is not refused.
@pytest.mark.parametrize(("distance_m", "limit_mm"), [(3.0, 0.07), *slow((10.0, 0.22))])
def test_gravity_and_a_gyroscope_tell_the_tilt_of_one_target(tmp_path, distance_m, limit_mm):
    site = Site(seed=1)
    site.write(tmp_path, (distance_m,), 0.01)
    result = estimated(tmp_path, with_gravity(BOX), CAMERA, GYROSCOPE)
    error, allowed = site.error(result)
    assert np.std(error) < limit_mm
    assert np.mean(np.abs(error) < allowed) > 0.9
    known = result.calibration.helped_by("gyroscope")
    assert abs(known.focal_px - FOCAL_PX) < 3.0 * known.focal_std_px
    # Without the tilt, which one target alone takes for scale: 0.83 of it at 3 m, 0.59 at 10 m.
    scale = abs(result.calibration.camera.scale.value_m_per_px) * FOCAL_PX / distance_m
    assert abs(scale - 1.0) < 0.03
    again = midspan.load_calibration(result.calibration.save(tmp_path / "calibration.json"))
    assert again.auxiliary == result.calibration.auxiliary


def test_a_gyroscope_alone_leaves_the_slow_tilt_in_the_band(tmp_path):
    site = Site(seed=2)
    site.write(tmp_path, (3.0,), 0.01)
    error, allowed = site.error(estimated(tmp_path, BOX, CAMERA, GYROSCOPE))
    assert np.mean(np.abs(error) < allowed) > 0.85
    assert np.median(allowed) > 0.2


@pytest.mark.parametrize("parts", [("",), *slow((GYROSCOPE,))])
def test_while_the_far_target_is_hidden_the_band_holds_the_tilt(tmp_path, parts):
    site = Site(seed=3)
    site.write(tmp_path, (3.0, 10.0), 0.003, hidden_s=(40.0, 50.0))
    result = estimated(tmp_path, with_gravity(BOX), CAMERA, *parts)
    error, allowed = site.error(result, (40.0, 50.0))
    assert np.mean(np.abs(error) < allowed) > 0.75
    assert np.max(np.abs(error)) < 0.6
    # It comes back without a step.
    error, allowed = site.error(result, (51.0, 80.0))
    assert np.mean(np.abs(error) < allowed) > 0.85
    assert np.std(error) < 0.003


def test_an_inclinometer_tells_the_slow_tilt(tmp_path):
    site = Site(seed=4)
    site.write(tmp_path, (3.0,), 0.01)
    error, allowed = site.error(estimated(tmp_path, BOX, CAMERA, INCLINOMETER, GYROSCOPE))
    assert np.mean(np.abs(error) < allowed) > 0.9
    assert np.std(error) < 0.07


# The zero of an inclinometer drifts by 0.02 mm in the record as the band takes it; here it does not.
@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
def test_an_inclinometer_and_a_lens_tell_a_slow_tilt_from_the_first_frame_on(tmp_path, seed):
    site = Site(seed=seed, length_s=60.0, nods=False)
    site.write(tmp_path, (3.0,), 0.004)
    result = estimated(tmp_path, BOX, CAMERA, LENS, INCLINOMETER)
    error, allowed = site.error(result)
    assert any("inclinometer: sign and scale" in line for line in result.not_in_band)
    assert "tilt-unverified" in {line.code for line in result.calibration.warnings}
    assert np.mean(np.abs(error) < allowed) > 0.93
    assert np.median(allowed) < 0.15
    assert np.std(error) < 0.015


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (lambda time_s, rate: -rate, "sign"),
        (lambda time_s, rate: np.interp(time_s - 0.2, time_s, rate), "clock"),
        (lambda time_s, rate: np.radians(rate), "unit"),
        (lambda time_s, rate: np.full_like(rate, 1e-3), "equal|frozen"),
        (lambda time_s, rate: np.random.default_rng(1).normal(0.0, 1e-3, len(rate)), "gyroscope"),
    ],
)
def test_a_wrong_gyroscope_is_left_out_with_the_reason(tmp_path, spoilt, said):
    site = Site(seed=5)
    site.write(tmp_path, (3.0, 10.0), 0.003, spoilt=spoilt)
    result = estimated(tmp_path, BOX, CAMERA, GYROSCOPE)
    left_out = [line for line in result.calibration.warnings if line.code == "part-left-out"]
    assert left_out
    assert re.search(said, left_out[0])
    error, allowed = site.error(result)
    assert np.mean(np.abs(error) < allowed) > 0.9
    assert np.std(error) < 0.003


def test_a_reversed_axis_of_the_camera_s_box_is_refused(tmp_path):
    site = Site(seed=9, length_s=60.0)
    site.write(tmp_path, (3.0,), 0.01)
    with pytest.raises(UntrustedError, match=r"accelerometer\.value_y: its sign"):
        estimated(tmp_path, with_gravity(BOX).replace('"ay"', '"-ay"'), CAMERA, GYROSCOPE)


# 5 K of a sensor with 0.15 mg/K are 43 mdeg, 2 mm at 3 m.
def test_gravity_of_a_box_that_warms_up_is_in_the_band(tmp_path):
    site = Site(seed=10, length_s=60.0)
    site.write(tmp_path, (3.0,), 0.01)
    head, *rows = (tmp_path / "box.csv").read_text().splitlines()
    values = np.array([row.split(",") for row in rows], dtype=float)
    part = np.clip((values[:, :1] - 20.0) / 20.0, 0.0, 1.0)
    values[:, 1:3] += 0.75e-3 * GRAVITY * part**2 * (3.0 - 2.0 * part)
    write_table(tmp_path / "box.csv", dict(zip(head.split(","), values.T, strict=True)))
    result = estimated(tmp_path, with_gravity(BOX), CAMERA, GYROSCOPE)
    error, allowed = site.error(result)
    assert np.mean(np.abs(error) < allowed) > 0.9
    assert any("accelerometer along the view" in line for line in result.not_in_band)


@pytest.mark.parametrize(("section", "said"), [('"-pitch"', "sign"), ('"pitch"\nunit = "rad"', "unit")])
def test_an_angle_that_contradicts_the_image_is_refused(tmp_path, section, said):
    site = Site(seed=11, length_s=60.0)
    site.write(tmp_path, (1.0,), 0.004)
    wrong = INCLINOMETER.replace('"pitch"\nunit = "deg"' if "unit" in section else '"pitch"', section)
    with pytest.raises(UntrustedError, match=f"inclinometer.*{said}"):
        estimated(tmp_path, BOX, CAMERA, LENS, wrong)


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda time_s, rate: np.where((time_s > 30.0) & (time_s < 35.0), np.nan, rate),
        lambda time_s, rate: np.where((time_s > 60.0) & (time_s < 70.0), rate[6000], rate),
        lambda time_s, rate: np.interp(time_s - 0.02, time_s, rate),
    ],
)
def test_a_gyroscope_that_is_gone_frozen_or_late_for_a_while_is_in_the_band(tmp_path, spoilt):
    site = Site(seed=6)
    site.write(tmp_path, (3.0,), 0.01, spoilt=spoilt)
    error, allowed = site.error(estimated(tmp_path, with_gravity(BOX), CAMERA, GYROSCOPE))
    assert np.mean(np.abs(error) < allowed) > 0.9


def test_a_rotation_needs_a_camera_and_its_axis(tmp_path):
    site = Site(seed=7, length_s=40.0)
    site.write(tmp_path, (3.0,), 0.01)
    with pytest.raises(UsageError, match=r"gyroscope\.value_x"):
        estimated(tmp_path, BOX, CAMERA, GYROSCOPE.replace("value_x", "value_z"))
    alone = '[displacement]\nfile = "box.csv"\nvalue = "pitch"\nunit = "mm"\n'
    with pytest.raises(UsageError, match="camera's tilt"):
        estimated(tmp_path, BOX.replace("value_y", "value"), alone, GYROSCOPE)


@pytest.mark.parametrize("lens", ["", LENS])
def test_what_holds_no_number_is_left_out(tmp_path, lens):
    site = Site(seed=8, length_s=40.0)
    site.angle *= 0.0
    site.write(tmp_path, (3.0,), 0.01)
    head, *rows = (tmp_path / "box.csv").read_text().splitlines()
    empty = [",".join([*row.split(",")[:3], "nan", "nan"]) for row in rows]
    (tmp_path / "box.csv").write_text("\n".join([head, *empty]) + "\n")
    result = estimated(tmp_path, BOX, CAMERA, lens, INCLINOMETER, GYROSCOPE)
    left_out = [line for line in result.calibration.warnings if line.code == "part-left-out"]
    assert {line.split()[0] for line in left_out} == {"[gyroscope]", "[inclinometer]"}
    assert not result.calibration.auxiliary
    assert "holds no number" in inspect_recording(midspan.open_recording(tmp_path))["gyroscope"]["error"]
    error, allowed = site.error(result)
    assert np.mean(np.abs(error) < allowed) > 0.9


@pytest.mark.parametrize(("scenario", "most_mm"), [("vibrometer", 0.4), *slow(("gyroscope", 0.1))])
def test_simulated_recordings_of_helping_sensors_are_inside_the_band(scenario, most_mm, tmp_path):
    folder = write(scenario, tmp_path / "recording", seed=2)
    result = midspan.estimate(folder)
    assert not any(line.code == "part-left-out" for line in result.warnings)
    found = midspan.compare(result, folder).to_dict()
    # Errors last for some ten seconds: a record holds few draws.
    assert found["coverage_95"] > 0.8
    # A GNSS receiver of 1 mm at 1 Hz alone: 0.66 mm; one target that tilts alone: 0.13 mm, or a refusal.
    assert found["without_zero"]["rmse_mm"] < most_mm
