import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from midspan.errors import DataError, UsageError
from midspan.records import Region
from midspan.vision.region import check_region, clamp, shift
from midspan.vision.roi import RoiSettings, choose_region, further_places

COLUMNS, ROWS = 480, 360
FIXED = Region(60, 100, 100, 100)
BORDER = Region(300, 0, 160, 30)
SATURATED = Region(250, 60, 100, 100)


def inside(region, other):
    x, y = region.x + region.width / 2, region.y + region.height / 2
    return other.x <= x < other.x + other.width and other.y <= y < other.y + other.height


@pytest.fixture(scope="module")
def street(make_scene, make_frame, camera):
    """Weak background, one textured fixed patch, and better textured ones that move, clip or lie on the border."""
    background, fixed, moving = make_scene(1, rms=4.0, highest=0.1), make_scene(2, rms=30.0), make_scene(3, rms=40.0)
    border, saturated = make_scene(4, rms=40.0), make_scene(5, rms=60.0)
    rng = np.random.default_rng(0)

    def image(k):
        dx, dy = 1.5 * np.sin(k), 2.0 * np.cos(0.7 * k) - 2.0
        own_x, own_y = 4 * k, round(3 * np.sin(2 * k))
        out = background.image(COLUMNS, ROWS, dx, dy)
        for scene, r, level in ((fixed, FIXED, 0.0), (border, BORDER, 0.0), (saturated, SATURATED, 150.0)):
            part = np.s_[r.y : r.y + r.height, r.x : r.x + r.width]
            out[part] = level + scene.image(COLUMNS, ROWS, dx, dy)[part]
        part = np.s_[200 + own_y : 300 + own_y, 220 + own_x : 320 + own_x]
        out[part] = moving.image(COLUMNS, ROWS, dx + own_x, dy + own_y)[part]
        return camera(out, rng, 1.5)

    return [make_frame(image(k), k) for k in range(12)]


def test_the_fixed_textured_patch_is_chosen_not_the_moving_saturated_or_border_one(street):
    choice = choose_region(street)
    assert inside(choice.region, FIXED)
    assert choice.region.width == choice.region.height == 64
    moving = [c for c in choice.candidates if inside(c.region, Region(200, 180, 140, 140))]
    assert moving
    assert not any(c.fixed for c in moving)
    assert any("move alike" in reason for reason in choice.reasons)


def test_the_score_map_rules_out_the_saturated_patch_and_prefers_texture(street):
    choice = choose_region(street)
    assert choice.score_px.shape == (len(choice.score_y), len(choice.score_x))
    j, i = np.argmin(np.abs(choice.score_y - 110)), np.argmin(np.abs(choice.score_x - 300))
    assert np.isnan(choice.score_px[j, i])
    i = np.argmin(np.abs(choice.score_x - 110))
    assert choice.score_px[j, i] < 0.01  # 30 DN of texture at 1.5 DN of noise: the bound is some 0.004 px
    assert choice.score_px[-1, 0] > 0.02  # the background


def test_the_predicted_deviation_is_that_of_the_track(make_scene, make_frame, camera):
    scene, rng = make_scene(7, highest=0.2), np.random.default_rng(7)
    frames = [make_frame(camera(scene.image(320, 240), rng, 3.0), k) for k in range(30)]
    best = choose_region(frames, RoiSettings(candidates=4)).candidates[0]
    scatter = np.std(best.track.y_px[1:])
    # The prediction is for two noisy frames (√2); fine texture counts as noise. It must be of the right size only.
    assert 0.7 < best.predicted_std_px / (np.sqrt(2) * scatter) < 2.5


def test_regions_keep_away_from_the_border_and_have_the_wanted_size(street):
    choice = choose_region(street, RoiSettings(size_px=40, margin_px=50, direction="x"))
    r = choice.region
    assert (r.width, r.height) == (40, 40)
    assert Region(r.x - 50, r.y - 50, 140, 140).inside(COLUMNS, ROWS)


def test_repeating_texture_is_avoided_and_said_when_there_is_nothing_else(make_scene, make_frame, camera):
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    bricks = 120 + 40 * np.sign(np.sin(0.4 * x) * np.sin(0.5 * y))
    only = choose_region([make_frame(camera(bricks, rng, 1.5))])
    assert any("repeat" in reason for reason in only.reasons)
    place = Region(280, 150, 100, 100)
    part = np.s_[150:250, 280:380]
    bricks[part] = make_scene(8, rms=20.0).image(COLUMNS, ROWS)[part]
    assert inside(choose_region([make_frame(camera(bricks, rng, 1.5))]).region, place)


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_an_image_without_texture_is_an_error_that_asks_for_a_region(make_frame, camera, noise):
    pixels = camera(np.full((ROWS, COLUMNS), 100.0), np.random.default_rng(0), noise)
    with pytest.raises(DataError, match=r"Give camera\.roi by hand"):
        choose_region([make_frame(pixels)])


def test_frames_must_be_there_and_of_one_size(make_frame):
    with pytest.raises(UsageError, match="at least one Frame"):
        choose_region([])
    with pytest.raises(DataError, match="one size"):
        choose_region([make_frame(np.zeros((50, 60))), make_frame(np.zeros((60, 50)))])


@pytest.mark.parametrize(
    "wrong", [{"direction": "z"}, {"size_px": 10}, {"margin_px": -1}, {"candidates": 0}, {"regions": 11}]
)
def test_settings_outside_their_range_are_refused(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        RoiSettings(**wrong)


def test_a_thermal_image_in_celsius_can_be_searched(make_scene, make_frame):
    scene, rng = make_scene(9, highest=0.2), np.random.default_rng(9)
    frames = [
        make_frame((20 + 0.05 * scene.image(160, 120, 0.3 * k, 0.0) + rng.normal(0, 0.05, (120, 160))), k)
        for k in range(6)
    ]
    choice = choose_region(frames)
    assert choice.region.inside(160, 120)
    assert choice.candidates[0].track.x_px[-1] == pytest.approx(1.5, abs=0.05)


def test_a_region_must_lie_inside_the_image_and_not_be_tiny():
    assert check_region(Region(0, 0, 640, 480), 640, 480) == Region(0, 0, 640, 480)
    with pytest.raises(UsageError, match=r"inside the image \(640x480 px\); received x=600"):
        check_region(Region(600, 0, 64, 64), 640, 480)
    with pytest.raises(UsageError, match="at least 12 px"):
        check_region(Region(0, 0, 5, 64), 640, 480)


regions = st.builds(Region, st.integers(-500, 900), st.integers(-500, 900), st.integers(1, 800), st.integers(1, 800))


@given(regions)
def test_a_clamped_region_is_inside_and_one_that_was_inside_stays(region):
    clamped = clamp(region, 640, 480)
    assert clamped.inside(640, 480)
    assert (clamped.width, clamped.height) == (min(region.width, 640), min(region.height, 480))
    if region.inside(640, 480):
        assert clamped == region


@given(regions, st.floats(-100, 100), st.floats(-100, 100))
def test_a_shifted_region_keeps_its_size_and_is_off_by_half_a_pixel_at_most(region, dx, dy):
    moved = shift(region, dx, dy)
    assert (moved.width, moved.height) == (region.width, region.height)
    assert abs(moved.x - region.x - dx) <= 0.5
    assert abs(moved.y - region.y - dy) <= 0.5


def test_further_places_leave_the_kept_alone_and_the_avoided_nearly(street):
    choice = choose_region(street)
    kept, avoided = choice.region, next(c.region for c in choice.candidates if not c.fixed)
    places = further_places(choice, [kept], [avoided], 5)
    assert places
    assert [std for _, std in places] == sorted(std for _, std in places)
    for region, std_px in places:
        assert std_px > 0
        assert max(abs(region.x - kept.x), abs(region.y - kept.y)) >= kept.width
        assert max(abs(region.x - avoided.x), abs(region.y - avoided.y)) >= avoided.width // 2


def test_several_regions_lie_apart_and_the_first_is_the_best(make_scene, make_frame, camera):
    scene, rng = make_scene(11, highest=0.2), np.random.default_rng(11)
    frames = [make_frame(camera(scene.image(320, 240, 0.0, np.sin(k)), rng, 3.0), k) for k in range(8)]
    one, three = (choose_region(frames, RoiSettings(regions=n)) for n in (1, 3))
    assert one.regions == three.regions[:1] == (three.region,)
    assert len(three.regions) == 3
    for k, region in enumerate(three.regions):
        for other in three.regions[:k]:
            assert max(abs(region.x - other.x), abs(region.y - other.y)) >= region.width
    assert [c.verdict for c in three.candidates[:3]] == ["taken"] * 3
