"""The simulated day: the sun's way, what both cameras see of it, and the recording that is written."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import shift

from midspan.errors import UsageError
from midspan.simulate.day.camera import DayCamera, wall_in_relief
from midspan.simulate.day.infrared import DayCourse, DayInfrared
from midspan.simulate.day.sky import DRYING_S, Drops, Headlights, Sky
from midspan.simulate.motion.motion import Sines, Window
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalCamera, ThermalView
from midspan.sources.thermal.formats import open_thermal

DAY_S = 240.0  # 10 s an hour
SIZE = (48, 64)


@pytest.fixture(scope="module")
def wall():
    return wall_in_relief(SIZE, rng=np.random.default_rng(3), reach_px=4.0)


def infrared(course=None, sky=None, **thermal):
    rng = np.random.default_rng(4)
    scenes = tuple(textured_scene("natural", SIZE, rng=r, reach_px=4.0, lens_px=0.9) for r in rng.spawn(2))
    course = course or DayCourse(mean_c=14.0, swing_k=6.0, period_s=DAY_S)
    return DayInfrared(ThermalView(scenes, 1.5, course, camera=ThermalCamera(**thermal)), sky or Sky(length_s=DAY_S))


def correlation(a, b):
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def test_the_sun_stands_highest_at_noon_and_sets_when_the_formula_of_the_day_length_says():
    sky = Sky(latitude_deg=45.0, declination_deg=8.0)
    # At noon the elevation is 90° - latitude + declination, at midnight the declination less the colatitude.
    assert sky.elevation_deg(0.0) == pytest.approx(90.0 - 45.0 + 8.0, abs=1e-9)
    assert sky.elevation_deg(43_200.0) == pytest.approx(8.0 - 45.0, abs=1e-9)
    start, end = sky.night()
    assert sky.elevation_deg(start) == pytest.approx(0.0, abs=1e-9)
    assert sky.elevation_deg(end) == pytest.approx(0.0, abs=1e-9)
    assert (end - start) / 3600 == pytest.approx(24.0 - 2.0 / 15.0 * np.degrees(np.arccos(-np.tan(np.radians(8.0)))))
    assert sky.night(1) == pytest.approx((start + 86_400.0, end + 86_400.0))


def test_the_light_comes_from_the_left_in_the_afternoon_and_the_direction_is_a_unit_vector():
    sky = Sky(length_s=DAY_S)
    for t in (0.0, 31.0, 55.0, 200.0):
        light = sky.light(t)
        assert light.right**2 + light.down**2 + light.out**2 == pytest.approx(1.0)
    # Who looks at a wall that faces south looks north: west, where the sun goes, is on the left.
    assert sky.light(30.0).right < -0.5
    assert sky.light(DAY_S - 30.0).right == pytest.approx(-sky.light(30.0).right)
    # Civil twilight (the sun 6° below the horizon) has about a thousandth of the full light, night nothing to speak of.
    dusk = next(t for t in np.arange(60.0, 80.0, 0.05) if sky.elevation_deg(t) < -6.0)
    assert 3e-4 < sky.light(dusk).mean < 3e-3
    assert sky.light(DAY_S / 2).mean < 1e-5


def test_fog_comes_and_goes_without_a_step_and_takes_the_contrast_it_promises(wall):
    sky = Sky(length_s=DAY_S, fog=((20.0, 40.0),), fog_depth=1.2, ramp_s=5.0)
    depth = np.array([sky.depth(t) for t in np.arange(15.0, 45.0, 0.1)])
    assert depth[0] == depth[-1] == 0.0
    assert depth.max() == pytest.approx(1.2)
    assert np.abs(np.diff(depth)).max() < 1.2 * np.pi / 2 / 50 + 1e-9  # the steepest part of a half cosine over 5 s
    clear = DayCamera(wall, Sky(length_s=DAY_S)).mean_image((0.0, 0.0), 30.0)
    foggy = DayCamera(wall, sky).mean_image((0.0, 0.0), 30.0)
    assert foggy.std() / clear.std() == pytest.approx(np.exp(-1.2), rel=1e-4)
    assert correlation(clear, foggy) == pytest.approx(1.0, abs=1e-4)
    warm, veiled = infrared().true_image((0.0, 0.0), 30.0), infrared(sky=sky).true_image((0.0, 0.0), 30.0)
    assert veiled.std() / warm.std() == pytest.approx(np.exp(-1.2 * 0.25), rel=1e-4)


def test_the_whole_picture_moves_by_what_it_is_reported_shadows_included(wall):
    camera = DayCamera(wall, Sky(length_s=DAY_S))
    for t in (5.0, 40.0):
        still, moved = camera.mean_image((0.0, 0.0), t), camera.mean_image((2.0, -3.0), t)
        # Whole pixels need no interpolation: equal to the last bits of single precision.
        np.testing.assert_allclose(moved[:-3, 2:], still[3:, :-2], atol=2e-5)
        half = camera.mean_image((0.0, 0.5), t)
        expected = shift(still.astype(np.float64), (0.5, 0.0), order=5, mode="nearest")
        # The product of light and wall reaches beyond the Nyquist frequency a little: a spline errs by some percent.
        assert np.std((half - expected)[8:-8, 8:-8]) < 0.06 * still.std()


def test_shading_and_the_shadow_of_the_post_follow_the_sun(wall):
    camera = DayCamera(wall, Sky(length_s=DAY_S))
    noon, late, again = (camera.mean_image((0.0, 0.0), t) for t in (0.0, 45.0, DAY_S))
    np.testing.assert_allclose(noon, again, atol=1e-5)
    # Shading from above gives way to shading from the side; what the wall reflects stays.
    assert 0.4 < correlation(noon, late) < 0.85
    # The sun is on the left in the afternoon, so the shadow goes to the right, by the tangent of its direction.
    light, columns = camera.sky.light(20.0), np.arange(SIZE[1])
    expected = wall.post_at_px - wall.post_px * light.right / light.out
    assert expected > wall.post_at_px + 3.0
    # The same wall without a post is divided out: what is left is the shadow alone.
    bare = replace(camera, wall=replace(wall, post_wide_px=-100.0)).mean_image((0.0, 0.0), 20.0)
    share = (camera.mean_image((0.0, 0.0), 20.0) / bare)[-10:].mean(axis=0)
    assert float(((1 - share) * columns).sum() / (1 - share).sum()) == pytest.approx(expected, abs=0.5)


def test_gain_keeps_the_mean_by_day_and_ends_at_night_where_only_noise_is_left(wall):
    camera = DayCamera(wall, Sky(length_s=DAY_S), seed=1)
    day, dusk, night = (camera.picture(k, np.zeros(2), t) for k, t in enumerate((0.0, 59.0, DAY_S / 2)))
    assert day.mean() == pytest.approx(127.5, abs=2.0)
    assert dusk.mean() == pytest.approx(127.5, abs=6.0)
    assert night.mean() < 2.0
    # 16 × read noise of 6 electrons of 10000: 2.4 DN, of which the lower half is cut off at black.
    assert np.std(night[night > 0]) < 2.4
    first, second = (camera.picture(k, np.zeros(2), DAY_S / 2).astype(float) for k in (5, 6))
    assert abs(correlation(first, second)) < 0.1
    assert day.dtype == np.uint8


def test_a_picture_does_not_depend_on_those_before_it(wall):
    sky = Sky(length_s=DAY_S, rain=((10.0, 20.0),))
    camera = DayCamera(wall, sky, drops=Drops(SIZE, sky.rain, rng=np.random.default_rng(1)), seed=7)
    np.testing.assert_array_equal(camera.picture(60, np.ones(2), 15.0), camera.picture(60, np.ones(2), 15.0))
    thermal = infrared(shutters_s=(3.0,), closed_s=1.0)
    times, moved = np.arange(24) / 4.0, np.zeros((24, 2))
    film = [thermal.film_number(k, moved, times) for k in range(24)]
    np.testing.assert_array_equal(thermal.film_number(20, moved, times), film[20])
    # Frozen while the shutter is closed, with another fixed pattern afterwards.
    for k in (12, 13, 14, 15):
        np.testing.assert_array_equal(film[k], film[11])
    assert not np.array_equal(film[16], film[11])


def test_headlights_dazzle_where_the_lamps_are_and_leave_with_the_car(wall):
    cars = Headlights((DAY_S / 2,), row_px=40.0, crossing_s=4.0)
    camera = DayCamera(wall, Sky(length_s=DAY_S), cars=cars)
    picture = camera.picture(0, np.zeros(2), DAY_S / 2 + 2.0)
    # Half-way the car is in the middle of the picture, its lamps 7 px with it.
    assert picture[40, 25] == picture[40, 39] == 255
    assert picture[40, 32] < 255
    assert camera.picture(0, np.zeros(2), DAY_S / 2 + 4.1).mean() < 2.0
    assert camera.picture(0, np.zeros(2), DAY_S / 2 - 0.1).mean() < 2.0


def test_drops_fall_in_the_rain_and_dry_within_the_time_reported():
    drops = Drops(SIZE, ((10.0, 20.0),), rng=np.random.default_rng(0))
    assert drops.cover(9.9) is None
    assert drops.cover(20.0 + DRYING_S) is None
    covered = [float(drops.cover(t).mean()) for t in (14.0, 19.9, 24.0)]
    assert covered[0] < covered[1] > covered[2] > 0.0
    assert 0.0 <= drops.cover(19.0).min() <= drops.cover(19.0).max() <= 1.0


def test_the_contrast_of_sunlit_surfaces_turns_around_between_day_and_night():
    thermal = infrared()
    dusk_s = (np.pi / 2 + 0.35) / (2 * np.pi) * DAY_S
    noon, dusk, midnight = (thermal.true_image((0.0, 0.0), t) for t in (0.0, dusk_s, DAY_S / 2))
    # Two patterns drawn independently correlate by chance: ±0.3 over the few large features of so small a picture.
    assert correlation(noon, midnight) == pytest.approx(-1.0, abs=1e-4)
    assert abs(correlation(noon, dusk)) < 0.5
    assert dusk.std() < 0.7 * noon.std()
    assert noon.mean() > midnight.mean() + 8.0


def test_refuses_a_place_where_the_sun_does_not_set():
    with pytest.raises(UsageError, match="sun rises and sets"):
        Sky(latitude_deg=80.0, declination_deg=20.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A short, small day under the name of the scenario."""
    with pytest.MonkeyPatch.context() as patch:
        base = SCENARIOS["day-and-night"]
        day = replace(
            base.day,
            sky=replace(base.day.sky, length_s=12.0, fog=(), rain=()),
            camera=replace(base.day.camera, size_px=(40, 48)),
            infrared=replace(base.day.infrared, size_px=(32, 40)),
            course=DayCourse(14.0, 6.0, 12.0),
            thermal=replace(base.day.thermal, shutters_s=(4.0,)),
        )
        motion = Window(Sines([2.5e-3], [0.4]), start_s=0.5)
        short = replace(base, duration_s=12.0, day=day, motion=lambda rng: motion, window_s=(0.0, 4.0))
        patch.setitem(SCENARIOS, "day-and-night", short)
        calls = []
        folder = tmp_path_factory.mktemp("day") / "site"
        write("day-and-night", folder, seed=2, progress=lambda done, total: calls.append((done, total)))
        return folder, calls


def test_the_recording_holds_both_cameras_the_truth_and_what_happened(written):
    folder, calls = written
    settings = tomllib.loads((folder / "recording.toml").read_text())
    known = json.loads((folder / "known.json").read_text())
    assert settings["camera"]["file"] == "camera.mkv"
    assert settings["infrared"]["file"] == "infrared.npz"
    assert settings["reference"]["file"] == "truth.csv"
    assert known["camera"]["scale_mm_per_px"] == -1.0
    assert known["infrared"]["time_offset_s"] == -0.083
    assert known["day"]["night_s"][0] == pytest.approx(Sky(length_s=12.0, declination_deg=-8.0).night())
    source = open_thermal(folder / "infrared.npz")
    frames = list(source.frames())
    assert calls[-1] == (len(frames) + 48, len(frames) + 48)  # 12 s less 0.1 and 0.137 s at 4 Hz: 48 frames
    assert frames[0].pixels.shape == (32, 40)
    assert frames[0].pixels.dtype == np.float32
    assert frames[0].time_ns == 60_000_000
    assert np.diff(source.times_ns()).tolist() == [250_000_000] * (len(frames) - 1)
    steps = frames[0].pixels.astype(np.float64) * 64.0
    np.testing.assert_array_equal(steps, np.rint(steps))
    truth = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
    # The zero is at the camera's first frame.
    assert np.interp(0.137, truth["time_s"], truth["displacement_mm"]) == pytest.approx(0.0, abs=1e-6)


def test_the_scenario_as_it_is_stays_in_reach_small_and_within_the_clock_search():
    scenario = SCENARIOS["day-and-night"]
    day = scenario.day
    for seed in range(4):
        moved = np.abs(scenario.motion(np.random.default_rng(seed)).displacement(np.arange(0.0, 264.0, 0.05))).max()
        assert 1e3 * moved < min(abs(day.camera.scale_mm_per_px), abs(day.infrared.scale_mm_per_px)) * day.reach_px
    assert 240.0 <= scenario.duration_s <= 300.0
    assert max(abs(day.camera.time_offset_s), abs(day.infrared.time_offset_s)) < 0.5
    start, end = day.sky.night()
    # Each of what the day promises happens, by day or by night as it should.
    assert all(start < s < end for s in day.cars.starts_s)
    assert all(start < body.start_s < end for body in day.bodies)
    assert day.sky.rain[0][1] < start
    assert day.sky.fog[0][0] < end < day.sky.fog[0][1]
