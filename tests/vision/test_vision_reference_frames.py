"""Key frames: all of them measure together, hand-overs leave no step, the first frame is found again."""

import numpy as np
import pytest
from reference_scenes import RATE_HZ, REGION, SIZE, Sky, shaded, swept, track

from midspan.errors import UsageError
from midspan.records import Frame
from midspan.vision.reference.light import mixed, placed, sight, steadiness
from midspan.vision.reference.pictures import aligned
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.tracker import KeyFrameTracker
from midspan.vision.tracker import open_tracker

DAY_DEG = 60.0 * -np.cos(np.pi * np.arange(150) / 150)
# As dark as 0.35 of noon in the middle, as in the published sweep.
DUSK = 1.0 - 0.65 * np.sin(np.pi * np.arange(150) / 150) ** 4


@pytest.fixture(scope="module")
def day():
    frames, moved = swept(1, DAY_DEG, DUSK)
    tracker = KeyFrameTracker(frames[0], REGION)
    events = []
    xy, std = track(tracker, frames, events)
    return frames, moved, tracker, xy, std, events


def picture(seed, angle_deg, moved=(0.0, 0.0)):
    """The wall without noise, as it is seen at rest when it lies at `moved` and is believed to lie at 0."""
    pixels = shaded(seed, moved, np.deg2rad(angle_deg), 1.0).astype(np.float64)
    return sight(pixels, REGION, np.zeros(2)).window(np.zeros(2))


def test_a_light_between_two_is_a_mix_of_them_and_its_motion_is_found_where_one_picture_errs() -> None:
    there = np.array([0.23, -0.31])
    frame = sight(shaded(4, there, np.deg2rad(-25.0), 0.6).astype(np.float64), REGION, np.zeros(2))
    one = mixed([picture(4, -40.0)], [np.zeros(2)])
    both = mixed([picture(4, -40.0), picture(4, 0.0)], [np.zeros(2)] * 2)
    alone = np.abs(placed(one, frame, np.zeros(2)).place - there).max()
    together = np.abs(placed(both, frame, np.zeros(2)).place - there).max()
    # Lambert's law is linear in the light's direction; flanks that see no light are not.
    assert together < 0.01
    assert alone > 3 * together


def test_the_shares_of_pictures_in_a_place_add_up_to_one() -> None:
    mix = mixed([picture(2, a) for a in (-40.0, 0.0, 30.0)], [np.zeros(2)] * 3)
    found = placed(mix, sight(shaded(2, (0.1, 0.2), 0.2, 1.0), REGION, np.zeros(2)), np.zeros(2))
    # Moving all pictures alike moves the place alike; what another mix explains is missing, about a hundredth.
    np.testing.assert_allclose(found.shares.sum(axis=1), 1.0, atol=0.03)


def test_pictures_that_lie_wrong_are_put_right_by_being_mixes_of_each_other() -> None:
    wrong = np.array([[0.0, 0.0], [0.06, -0.04], [-0.05, 0.05], [0.03, 0.06], [-0.06, 0.02]])
    angles = (-50.0, -25.0, 0.0, 25.0, 50.0)
    for seed in (1, 4):
        made = [picture(seed, a, d) for a, d in zip(angles, wrong, strict=True)]
        found = aligned(mixed(made, [np.zeros(2)] * 5))
        # To be read farther on by as much as the target lies farther on.
        error = np.abs(found.moves - wrong)
        assert error.max() < 0.03
        assert error.mean() < 0.3 * np.abs(wrong).mean()
        np.testing.assert_array_equal(found.moves[0], 0.0)
        std = np.sqrt(np.stack([np.diag(c) for c in found.covariance], axis=1))[1:]
        assert np.sqrt(np.mean((error[1:] / std) ** 2)) < 2.5


def test_a_picture_that_is_no_mix_of_the_others_says_so() -> None:
    def alone(sky, angles=(-55.0, -30.0, -5.0, 20.0)):
        frames = [shaded(0, (0.0, 0.0), np.deg2rad(a), 1.0, 0.3, sky).astype(np.float64) for a in angles]
        made = [sight(f, REGION, np.zeros(2)).window(np.zeros(2)) for f in frames]
        return aligned(mixed(made, [np.zeros(2)] * len(angles))).alone[0]

    assert alone(Sky(cast=True)) > 2 * alone(Sky())


def test_pixels_that_do_not_keep_to_the_mix_count_less() -> None:
    rng = np.random.default_rng(0)
    pictures = rng.normal(size=(400, 2)) @ rng.normal(size=(2, 4))
    pictures[:40, 2] += 3.0
    pictures /= np.linalg.norm(pictures, axis=0)
    weight = steadiness(pictures, np.ones(400))[0]
    assert weight[:40].max() < 0.3 * weight[40:].mean()
    assert weight.mean() == pytest.approx(1.0)


def test_in_steady_light_there_is_one_key_frame_and_the_track_is_the_inner_trackers() -> None:
    frames, _ = swept(2, np.full(40, 30.0))
    tracker, events = KeyFrameTracker(frames[0], REGION), []
    np.testing.assert_array_equal(
        track(tracker, frames, events)[0], track(open_tracker("template", frames[0], REGION), frames)[0]
    )
    assert tracker.key_frames == 1
    assert events == []


def test_a_light_sweep_of_sixty_degrees_either_way_is_followed_without_a_gap(day) -> None:
    frames, moved, tracker, xy, std, _ = day
    fixed, _ = track(open_tracker("template", frames[0], REGION), frames)
    assert np.isnan(fixed[:, 0]).mean() > 0.4  # a fixed reference loses 40 % or more
    assert not np.isnan(xy).any()
    assert 3 <= tracker.key_frames <= 15
    error = xy - moved
    # Key frames alone, each a reference of its own, come to 0.10 px on this wall: shading moves over the bumps.
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert np.mean(np.abs(error) < 1.96 * std) > 0.93
    assert std[-1].min() > 2 * std[3].max()


def test_a_light_that_swings_across_as_well_is_followed_on_other_walls() -> None:
    for seed in (21, 25):
        frames, moved = swept(seed, DAY_DEG, DUSK, sky=Sky(aside=(-0.8, 0.8), ambient=0.2))
        xy, std = track(KeyFrameTracker(frames[0], REGION), frames)
        error = xy - moved
        assert np.sqrt(np.mean(error**2)) < 0.08
        assert np.mean(np.abs(error) < 1.96 * std) > 0.93


def test_a_hand_over_leaves_no_step(day) -> None:
    _, moved, _, xy, _, events = day
    times = [round(event.time_ns / 1e9 * RATE_HZ) for event in events]
    assert len(times) >= 2
    error = xy - moved
    steps = [error[k + 1 : k + 4].mean(axis=0) - error[k - 2 : k + 1].mean(axis=0) for k in times if k + 4 < len(xy)]
    # The goal is 0.02 px; means of three frames of 0.01 px scatter by 0.008 px.
    assert np.sqrt(np.mean(np.square(steps))) < 0.02


def test_when_the_light_comes_back_the_first_frame_takes_back_what_has_added_up() -> None:
    there = -50.0 + 80.0 * np.arange(60) / 60
    frames, moved = swept(3, np.concatenate([there, there[::-1], np.full(30, -50.0)]))
    tracker = KeyFrameTracker(frames[0], REGION)
    events = []
    xy, std = track(tracker, frames, events)
    assert tracker.key_frames > 2
    assert tracker.state.current == 0
    assert any("back to the first frame" in event.text for event in events)
    assert np.abs((xy - moved)[-10:]).max() < 0.05
    assert std[-1].max() < 0.3 * std[60].max()


def test_a_dark_camera_is_lost_and_afterwards_there_is_no_step() -> None:
    frames, moved = swept(2, np.full(40, 30.0))
    rng = np.random.default_rng(0)
    dark = [
        Frame(f.time_ns, rng.integers(0, 5, SIZE).astype(np.uint8), f.index) if 15 <= f.index < 22 else f
        for f in frames
    ]
    tracker = KeyFrameTracker(frames[0], REGION)
    xy, _ = track(tracker, dark)
    assert np.flatnonzero(np.isnan(xy[:, 0])).tolist() == list(range(15, 22))
    assert tracker.key_frames == 1
    assert np.abs((xy - moved)[22:]).max() < 0.05


def test_no_more_key_frames_are_kept_than_were_asked_for(day) -> None:
    frames, moved = day[:2]
    tracker = KeyFrameTracker(frames[0], REGION, KeyFrameSettings(most=3))
    xy, _ = track(tracker, frames)
    assert tracker.key_frames > 3
    assert len(tracker.state.chain) <= 3
    assert not np.isnan(xy).any()
    assert np.sqrt(np.mean((xy - moved) ** 2)) < 0.2


@pytest.mark.parametrize("cut", [7, 33, 61])
def test_a_tracker_restored_from_its_state_goes_on_alike(day, cut: int) -> None:
    frames, xy = day[0], day[3]
    first = KeyFrameTracker(frames[0], REGION)
    track(first, frames[:cut])
    other = KeyFrameTracker(frames[0], REGION)
    other.restore(first.state)
    np.testing.assert_array_equal(track(other, frames[cut:90])[0], xy[cut:90])


@pytest.mark.parametrize("wrong", [{"renew_share": 0.99}, {"overlap_frames": 2}, {"most": 2}, {"tracker": "nearest"}])
def test_settings_out_of_range_are_refused(wrong) -> None:
    with pytest.raises(UsageError):
        KeyFrameSettings(**wrong)
