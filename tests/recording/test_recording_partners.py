"""What a camera of one target needs to be free of its tilt: a second camera on its box, or a radar.

Two cameras: 5000 and 3000 px, targets at 3 and 10 m, clocks 0.11 and 0.37 s late, 30 and 25 frames/s.
"""

import numpy as np
import pytest

import midspan
from lively_recordings import CARRIER_HZ, CONVERSION, SPEED_OF_LIGHT_M_S
from pinhole_tracks import MODES, MOTION, NODS, SUN, TILT, Site, nothing, rotation, stacked, table, times, together
from repeats import slow

CAMERAS = {"a": (3.0, 5000.0, 0.11, 30.0), "b": (10.0, 3000.0, 0.37, 25.0)}
LEAN = times(MOTION, np.pi / 45.0)
RADAR_LATE_S, RADAR_HZ, RADAR_FROM_S = -0.07, 50.0, 0.8


def two_cameras(folder, turn, more=("", ""), kinds=("camera", "camera"), duration_s=60.0, order="ab"):
    """The recording of a box with two cameras that turns about x."""
    site = Site(duration_s=duration_s, turns=(turn, nothing, nothing))
    site.write(folder)
    text = '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n'
    rng = np.random.default_rng(3)
    for name, kind, lines in zip(order, kinds, more, strict=True):
        distance_m, focal_px, late_s, rate_hz = CAMERAS[name]
        met_s = np.arange(1.0 if name == order[0] else 1.0037, duration_s - 0.5, 1.0 / rate_hz)
        none = np.zeros_like(met_s)
        point = np.stack((none, site.motion(met_s), none + distance_m), axis=-1)
        seen = np.einsum("nji,nj->ni", rotation(np.stack((turn(met_s), none, none), axis=-1)), point)
        px = focal_px * seen[:, :2] / seen[:, 2:] + rng.normal(0.0, site.noise_px, (len(met_s), 2))
        columns = {"time_s": met_s - late_s, "x_px": px[:, 0] - px[0, 0], "y_px": px[:, 1] - px[0, 1]}
        table(folder / f"{name}.csv", columns)
        text += f'[[{kind}]]\nname = "{name}"\nfile = "{name}.csv"\ndirection = "y"\n{lines}'
    (folder / "recording.toml").write_text(text)
    return site


def with_radar(folder, site):
    """The recording of a site whose radar measures along the motion."""
    site.write(folder)
    met_s = np.arange(RADAR_FROM_S, site.duration_s - 0.3, 1.0 / RADAR_HZ)
    phase = 4.0 * np.pi * CARRIER_HZ / SPEED_OF_LIGHT_M_S * site.motion(met_s) / CONVERSION
    noise = np.random.default_rng(5).normal(0.0, 0.02, (2, len(met_s)))
    np.save(folder / "radar.npy", (np.exp(1j * (phase + 0.7)) + noise[0] + 1j * noise[1]).astype(np.complex64))
    with (folder / "recording.toml").open("a") as file:
        file.write(
            f'[radar]\nfile = "radar.npy"\nrate_hz = {RADAR_HZ}\nstart_s = {RADAR_FROM_S - RADAR_LATE_S}\n'
            f"carrier_hz = {CARRIER_HZ!r}\n"
        )
    return folder


def scored(site, result, first_s=1.0):
    """Rms of the error and of the error without its mean (mm), and the share in the band."""
    error = result.displacement_mm - 1e3 * (site.motion(result.time_s) - site.motion(np.array([first_s])))
    return np.sqrt(np.mean(error**2)), np.std(error), np.mean(np.abs(error) < 1.96 * result.displacement_std_mm)


@pytest.mark.parametrize(
    ("turn", "kinds", "order"),
    [
        (TILT, ("camera", "infrared"), "ab"),
        *slow((TILT, ("camera", "camera"), "ba"), (NODS, ("camera", "camera"), "ab")),
    ],
)
def test_two_cameras_on_one_box_remove_the_tilt_that_they_share(turn, kinds, order, tmp_path):
    site = two_cameras(tmp_path, turn, kinds=kinds, order=order)
    result = midspan.estimate(tmp_path)
    rms, own, share = scored(site, result)
    # A frame of the difference is good for 0.008 mm; one camera alone errs by 0.16 mm.
    assert own < 0.006
    # The zero, of one frame each, is known to 0.008 mm.
    assert rms < 0.025
    assert share > 0.9
    assert np.median(result.displacement_std_mm) < 0.02
    known = {name: one for name, _, one in result.calibration.sensors}
    late_s = {name: one.offset.value_s for name, one in known.items()}
    assert late_s == pytest.approx({name: CAMERAS[name][2] for name in CAMERAS}, abs=1e-3)
    follower = known[order[1]]
    assert follower.tilt_of == order[0]
    # By the nods, 0.13 px: to a fiftieth.
    assert follower.tilt_ratio == pytest.approx(CAMERAS[order[1]][1] / CAMERAS[order[0]][1], rel=0.02)
    assert any(one.code == "tilt" for one in result.warnings)


def test_a_calibration_of_two_cameras_read_back_gives_the_same_rows(tmp_path):
    two_cameras(tmp_path, TILT)
    calibration = midspan.calibrate(tmp_path)
    calibration.save(tmp_path / "calibration.json")
    again = midspan.estimate(tmp_path, tmp_path / "calibration.json")
    rows = midspan.estimate(tmp_path, calibration)
    np.testing.assert_allclose(again.displacement_mm, rows.displacement_mm, atol=1e-6)


@pytest.mark.parametrize("turn", [together(SUN, LEAN), *slow(SUN)])
def test_a_slow_tilt_that_nothing_compares_is_in_the_band_of_two_cameras_or_refused(turn, tmp_path):
    site = two_cameras(tmp_path, turn)
    try:
        result = midspan.estimate(tmp_path)
    except midspan.UntrustedError as refused:
        said = [str(refused)]
    else:
        said = list(result.warnings)
        assert scored(site, result)[2] > 0.9
    assert any("let one camera see targets at both distances, add a [gyroscope]" in line for line in said)


def test_lenses_and_distances_compare_a_slow_tilt(tmp_path):
    # Focal lengths half a percent off.
    more = tuple(
        f"[camera.lens]\nmatrix = [{focal}, {focal}, 41.5, 41.5]\ndistortion = [0.0, 0.0, 0.0, 0.0]\nsize = [84, 84]\n"
        f'[[camera.target]]\nname = "1"\nroi = [0, 0, 48, 48]\ndistance_m = {distance_m}\n'
        for focal, distance_m in ((5025.0, 3.0), (2985.0, 10.0))
    )
    site = two_cameras(tmp_path, together(SUN, LEAN), more)
    rms, own, share = scored(site, midspan.estimate(tmp_path))
    # By the focal lengths 0.8 % of the tilt are left.
    assert own < 0.012
    assert rms < 0.025
    assert share > 0.9


def test_two_cameras_that_do_not_tilt_stay_as_they_are(tmp_path):
    site = two_cameras(tmp_path, nothing)
    result = midspan.estimate(tmp_path)
    assert all(one.tilt_std_px == 0.0 for _, _, one in result.calibration.sensors)
    assert scored(site, result)[1] < 0.003


@pytest.mark.parametrize(
    ("turn", "distance_m"), [(together(SUN, LEAN), 3.0), *slow((TILT, 10.0), (TILT, 3.0), (SUN, 10.0))]
)
def test_a_radar_tells_the_tilt_of_a_camera(turn, distance_m, tmp_path):
    site = Site(targets=stacked(distance_m), turns=(turn, nothing, nothing))
    folder = with_radar(tmp_path, site)
    result = midspan.estimate(folder)
    rms, own, share = scored(site, result)
    (tmp_path / "alone.toml").write_text(
        (tmp_path / "recording.toml").read_text().replace('[camera]\nfile = "track.csv"\ndirection = "y"\n', "")
    )
    alone = scored(site, midspan.estimate(tmp_path / "alone.toml"), RADAR_FROM_S)
    # Nearly as good as the radar alone: a tilt that goes with the motion is taken for one without a memory. The zero is
    # the camera's first frame.
    assert own < 1.8 * alone[1]
    assert rms < 0.012
    assert share > 0.9
    (said,) = [one for one in result.warnings if one.code == "tilt"]
    assert "which the radar does not show" in said
    assert not any(one.code in ("motion-not-shared", "zero-shifted") for one in result.warnings)


def test_a_radar_and_a_camera_at_rest_stay_as_they_are(tmp_path):
    site = Site(targets=stacked(3.0), turns=(nothing,) * 3, motion=MODES)
    result = midspan.estimate(with_radar(tmp_path, site))
    assert result.calibration.camera.tilt_std_px == 0.0
    assert scored(site, result)[2] > 0.9


def test_infrared_targets_at_two_distances_remove_the_tilt_as_those_of_a_camera(tmp_path):
    site = Site()
    site.write(tmp_path)
    by_camera = midspan.estimate(tmp_path)
    path = tmp_path / "recording.toml"
    path.write_text(path.read_text().replace("[camera]", "[infrared]"))
    by_infrared = midspan.estimate(tmp_path)
    np.testing.assert_allclose(by_infrared.displacement_mm, by_camera.displacement_mm, atol=1e-9)
    np.testing.assert_allclose(by_infrared.displacement_std_mm, by_camera.displacement_std_mm, rtol=1e-6)
    assert any(one.code == "tilt" and one.startswith("infrared: it tilts") for one in by_infrared.warnings)
