import math

import numpy as np
import pytest

from midspan.papers.printed.features import consensus, within_largest
from midspan.records import Prediction
from midspan.vision.rejection import (
    best_match,
    distance_limits,
    distance_variation,
    near_median,
    rejection_one,
    rejection_two,
    repeated_rejection_one,
)


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def scattered(rng, count, *, shift=(3.2, -1.4), error=0.05):
    first = rng.uniform(0, 120, (count, 2))
    return first, first + np.array(shift) + rng.normal(0, error, (count, 2))


def test_the_distance_variation_index_is_that_of_equation_15():
    # 1 - 40/50 = 0.2, equal lengths give 0, nothing against something gives 1
    index = distance_variation(np.array([40.0, 50.0, 7.0, 0.0, 0.0]), np.array([50.0, 40.0, 7.0, 3.0, 0.0]))
    assert index == pytest.approx([0.2, 0.2, 0.0, 1.0, 1.0])


def test_the_distance_limits_are_those_of_equation_16():
    # With epsilon 0.5: (|3| ± 1, |-4| ± 1) gives √(2² + 3²) and √(4² + 5²); below 2 epsilon the least is none at all.
    least, largest = distance_limits(np.array([[3.0, -4.0], [0.4, 10.0]]), 0.5)
    assert least == pytest.approx([math.sqrt(13), 9.0])
    assert largest == pytest.approx([math.sqrt(41), math.hypot(1.4, 11.0)])
    # As printed the equation squares (0.4 - 1), which counts as 0.6.
    least, _ = distance_limits(np.array([[3.0, -4.0], [0.4, 10.0]]), 0.5, literal=True)
    assert least == pytest.approx([math.sqrt(13), math.hypot(0.6, 9.0)])


def test_the_best_match_belongs_to_the_pair_whose_distance_is_kept(rng):
    first, now = scattered(rng, 8, error=3.0)
    now[5] = first[5] + np.array([3.2, -1.4])
    now[2] = first[2] + np.array([3.2, -1.4])
    found = [best_match(first, now, np.random.default_rng(seed)) for seed in range(400)]
    # 2 and 5 meet in one of seven pairings, and always win then; both orders occur
    hits = np.isin(found, (2, 5)).mean()
    assert hits > 1 / 7
    assert {2, 5} <= set(found)


def test_rejection_one_keeps_what_equation_17_keeps():
    # Four points of a square and one that went astray by (6, 0): its distance to each of the others is out of bounds.
    first = np.array([[0.0, 0.0], [40.0, 0.0], [0.0, 40.0], [40.0, 40.0], [80.0, 0.0]])
    now = first + np.array([2.0, 5.0])
    now[4, 0] += 6.0
    for seed in range(20):
        keep = rejection_one(first, now, 0.5, rng=np.random.default_rng(seed))
        assert keep.tolist() == [True, True, True, True, False]
    # By hand, best match (0, 0): 80 ± 1 then and 86 ± 1 now; the least now, 85, exceeds the largest then, √(81² + 1).
    least, largest = distance_limits(np.array([[80.0, 0.0], [86.0, 0.0]]), 0.5)
    assert largest[0] < least[1]
    # A shift of 1.5 px lies within the limits of both, 2 epsilon each: it stays.
    now[4, 0] -= 4.5
    assert rejection_one(first, now, 0.5, rng=np.random.default_rng(0)).all()


def test_rejection_one_takes_out_most_of_many_mismatches_and_no_good_match(rng):
    first, now = scattered(rng, 100)
    wrong = np.arange(100) >= 70
    now[wrong] = rng.uniform(0, 120, (30, 2))
    keep = rejection_one(first, now, 0.5, rng=rng)
    assert keep[~wrong].all()
    # A chance distance falls within some ±4 px of the true one of 60 px on average: about one in ten.
    assert keep[wrong].mean() < 0.3


def test_the_same_seed_gives_the_same_set(rng):
    first, now = scattered(rng, 60)
    now[40:] = rng.uniform(0, 120, (20, 2))
    one, two = (rejection_one(first, now, 0.5, rng=np.random.default_rng(4)) for _ in range(2))
    assert np.array_equal(one, two)


def test_pairing_anew_recovers_from_a_best_pair_of_two_equal_mismatches():
    rng = np.random.default_rng(0)
    first = rng.uniform(0, 200, (40, 2))
    now = first + np.array([1.0, 2.0]) + rng.normal(0, 0.2, (40, 2))
    now[:10] = first[:10] + np.array([45.0, 2.0])  # ten matches one window further on, without noise: always the best
    alone = [rejection_one(first, now, 0.5, rng=np.random.default_rng(s)) for s in range(20)]
    assert min(int(k[10:].sum()) for k in alone) < 15
    for seed in range(20):
        keep = repeated_rejection_one(first, now, 0.5, rng=np.random.default_rng(seed))
        assert keep.sum() >= alone[seed].sum()


def test_fewer_than_two_matches_have_no_distance(rng):
    assert rejection_one(np.zeros((1, 2)), np.zeros((1, 2)), 0.5, rng=rng).tolist() == [False]
    assert rejection_one(np.zeros((0, 2)), np.zeros((0, 2)), 0.5, rng=rng).tolist() == []


def test_rejection_two_keeps_the_interval_of_equation_29():
    # y: 10.3 ± (3 · 0.4 + 2 · 0.5) = 8.1 … 12.5; x: 0 ± (3 · 2 + 1) = -7 … 7
    prediction = Prediction(0.0, 10.3, 2.0, 0.4)
    translation = np.array([[0.0, 8.11], [0.0, 8.09], [6.9, 12.49], [0.0, 12.51], [7.1, 10.0], [-6.9, 10.0]])
    assert rejection_two(translation, prediction, 0.5).tolist() == [True, False, True, False, False, True]


def test_rejection_two_leaves_an_axis_alone_that_is_not_predicted():
    translation = np.array([[500.0, 1.0], [0.0, 5.0]])
    assert rejection_two(translation, Prediction(0.0, 1.0, math.inf, 0.1), 0.5).tolist() == [True, False]


def test_the_median_rule_takes_out_what_is_far_and_keeps_a_rolling_target(rng):
    translation = np.array([2.0, 3.0]) + rng.normal(0, 0.1, (50, 2))
    translation[:5] += 4.0
    assert near_median(translation, 1.0).tolist() == [False] * 5 + [True] * 45
    rolled = np.linspace(-1.5, 1.5, 41)[:, None] * np.array([1.0, -1.0])
    assert near_median(rolled, 1.0).all()
    assert near_median(np.zeros((0, 2)), 1.0).tolist() == []


def test_pre_purification_and_consensus_keep_the_largest_group_within_reach():
    translation = np.array([[1.0, 0], [2.0, 0], [3.0, 1], [40.0, 0], [41.0, 0], [20.0, 20.0], [0.0, 30.0]])
    assert within_largest(translation, 29.0).tolist() == [True, True, True, False, False, True, False]
    assert consensus(translation, 5.0).tolist() == [True, True, True, False, False, False, False]
    assert consensus(translation[:0], 5.0).tolist() == []
