"""Key frames: their chain is a least-squares solution, hand-overs leave no step, the first frame is found again."""

import numpy as np
import pytest
from reference_scenes import RATE_HZ, REGION, SIZE, swept, track

from midspan.errors import UsageError
from midspan.records import Frame
from midspan.vision.reference_chain import Link, first_chain, mean_link
from midspan.vision.reference_frames import KeyFrameSettings, KeyFrameTracker
from midspan.vision.tracker import open_tracker

DAY_DEG = 60.0 * -np.cos(np.pi * np.arange(150) / 150)
# As dark as 0.35 of noon in the middle, as in the published sweep.
DUSK = 1.0 - 0.65 * np.sin(np.pi * np.arange(150) / 150) ** 4


@pytest.fixture(scope="module")
def day():
    frames, moved = swept(1, DAY_DEG, DUSK)
    tracker = KeyFrameTracker(frames[0], REGION)
    xy, std = track(tracker, frames)
    return frames, moved, tracker, xy, std


def test_the_chain_is_the_least_squares_solution_of_all_links() -> None:
    rng = np.random.default_rng(0)
    truth = rng.normal(0.0, 3.0, (5, 2))
    truth[0] = 0.0
    ends = [(0, 1), (1, 2), (0, 2), (2, 3), (1, 3), (3, 4), (0, 4)]
    links = [Link(a, b, truth[b] - truth[a] + rng.normal(0, 0.02, 2), np.array([4e-4, 9e-4])) for a, b in ends]
    chain = first_chain()
    for link in links:
        chain = chain.extended() if link.end == len(chain) else chain
        chain = chain.linked(link)
    for axis, variance in enumerate((4e-4, 9e-4)):
        design = np.zeros((len(links), 4))
        for row, link in enumerate(links):
            design[row, link.end - 1] = 1.0
            if link.start:
                design[row, link.start - 1] = -1.0
        normal = design.T @ design / variance
        solution = np.linalg.solve(normal, design.T @ [link.value[axis] for link in links] / variance)
        # The unknown start has a variance of 1e8 px², not an infinite one.
        np.testing.assert_allclose(chain.place[1:, axis], solution, atol=1e-6)
        np.testing.assert_allclose(chain.covariance[axis, 1:, 1:], np.linalg.inv(normal), rtol=1e-4)
    np.testing.assert_array_equal(chain.place[0], 0.0)
    shorter = chain.without(2)
    np.testing.assert_array_equal(shorter.place, np.delete(chain.place, 2, axis=0))


def test_errors_add_up_along_a_chain_and_a_link_to_its_start_takes_them_back() -> None:
    chain, variance = first_chain(), np.full(2, 0.01**2)
    for end in range(1, 10):
        chain = chain.extended().linked(Link(end - 1, end, np.ones(2), variance))
    assert np.sqrt(chain.variance(9)) == pytest.approx(0.03, rel=1e-3)  # 0.01 √9
    closed = chain.linked(Link(0, 9, np.full(2, 9.05), variance))
    # 9.00 ± 0.03 and 9.05 ± 0.01: weights 1 to 9.
    assert closed.place[9] == pytest.approx(9.045, abs=1e-4)
    assert closed.place[4] == pytest.approx(4.0 + 0.045 * 4 / 9, abs=1e-4)


def test_a_link_that_contradicts_the_chain_moves_it_little() -> None:
    chain = first_chain().extended().linked(Link(0, 1, np.zeros(2), np.full(2, 1e-4)))
    pulled = chain.linked(Link(0, 1, np.full(2, 5.0), np.full(2, 1e-4)))
    assert np.abs(pulled.place[1]).max() < 0.01


def test_a_constant_difference_is_known_better_the_more_frames_there_are() -> None:
    rng = np.random.default_rng(1)
    pairs = 0.3 + rng.normal(0.0, 0.02, (400, 2))
    few, many = (mean_link(pairs[:n], np.full((n, 2), 4e-4), 0.0) for n in (4, 400))
    assert np.abs(many[0] - 0.3).max() < 0.005
    assert np.all(many[1] < few[1] / 20)
    floor = mean_link(pairs, np.full((400, 2), 4e-4), 0.01)[1]
    assert np.sqrt(floor).min() >= 0.01


def test_in_steady_light_there_is_one_key_frame_and_the_track_is_the_inner_trackers() -> None:
    frames, _ = swept(2, np.full(40, 30.0))
    tracker = KeyFrameTracker(frames[0], REGION)
    np.testing.assert_array_equal(
        track(tracker, frames)[0], track(open_tracker("template", frames[0], REGION), frames)[0]
    )
    assert tracker.key_frames == 1
    assert tracker.take_events() == []


def test_a_light_sweep_of_sixty_degrees_either_way_is_followed_without_a_gap(day) -> None:
    frames, moved, tracker, xy, std = day
    fixed, _ = track(open_tracker("template", frames[0], REGION), frames)
    assert np.isnan(fixed[:, 0]).mean() > 0.4  # a fixed reference loses 40 % or more
    assert not np.isnan(xy).any()
    assert 3 <= tracker.key_frames <= 15
    error = xy - moved
    assert np.sqrt(np.mean(error**2)) < 0.12
    # Two axes of one run whose errors belong together: 95 % would be too much to ask.
    assert np.mean(np.abs(error) < 1.96 * std) > 0.85
    assert std[-1].min() > 2 * std[3].max()


def test_a_hand_over_leaves_no_step(day) -> None:
    _, moved, tracker, xy, _ = day
    times = [round(event.time_ns / 1e9 * RATE_HZ) for event in tracker.take_events()]
    assert len(times) >= 2
    error = xy - moved
    steps = [error[k + 1 : k + 4].mean(axis=0) - error[k - 2 : k + 1].mean(axis=0) for k in times if k + 4 < len(xy)]
    # The goal is 0.02 px; means of three frames of 0.01 px scatter by 0.008 px.
    assert np.sqrt(np.mean(np.square(steps))) < 0.02


def test_when_the_light_comes_back_the_first_frame_takes_back_what_has_added_up() -> None:
    there = -50.0 + 80.0 * np.arange(60) / 60
    frames, moved = swept(3, np.concatenate([there, there[::-1], np.full(30, -50.0)]))
    tracker = KeyFrameTracker(frames[0], REGION)
    xy, std = track(tracker, frames)
    assert tracker.key_frames > 2
    assert tracker.current == 0
    assert any("back to the first frame" in event.text for event in tracker.take_events())
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
    assert len(tracker.chain) <= 3
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
