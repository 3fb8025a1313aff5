"""Six degrees of freedom of a camera from fixed targets, against a pinhole written here with plain matrices."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from midspan.vision.pose import Geometry, by_geometry, inflation, poses, rotated, rotation_vector

FOCAL_PX, NOISE_PX = 5000.0, 0.003
# Left and right at 3 m, below between them at 10 m.
PLACE_PX = np.array([[-800.0, -350.0], [800.0, -350.0], [100.0, 400.0]])
DISTANCE_M = np.array([3.0, 3.0, 10.0])


def seen_px(place_px, distance_m, pose):
    """Where a camera at each pose (n, 6) sees points, less where it sees them at rest; a turn by 4-by-4 matrices."""
    points = np.column_stack((place_px / FOCAL_PX * distance_m[:, None], distance_m, np.ones(len(distance_m))))
    found = []
    for row in pose:
        camera = np.eye(4)
        camera[:3, :3] = Rotation.from_rotvec(row[3:]).as_matrix()
        camera[:3, 3] = row[:3]
        own = np.linalg.solve(camera, points.T)
        found.append(FOCAL_PX * (own[:2] / own[2]).T - place_px)
    return np.array(found)


def geometry(place_px=PLACE_PX, distance_m=DISTANCE_M):
    return Geometry(np.full(2, FOCAL_PX), np.asarray(place_px), 1.0 / np.asarray(distance_m))


def drawn(rng, count):
    """Poses up to 50 mm and 0.5°, 1° about the view."""
    return rng.uniform(-1.0, 1.0, (count, 6)) * np.array([0.05, 0.05, 0.05, *np.radians([0.5, 0.5, 1.0])])


def bound(place_px, distance_m, noise_px):
    """Cramér-Rao bound (6,) at rest by differences of the pinhole above."""
    step = 1e-5
    slopes = [
        (seen_px(place_px, distance_m, step * row) - seen_px(place_px, distance_m, -step * row)).ravel() / (2 * step)
        for row in np.eye(6)[:, None]
    ]
    return np.sqrt(np.diag(np.linalg.inv(np.array(slopes) @ np.array(slopes).T))) * noise_px


def test_large_motions_are_solved_exactly():
    pose = drawn(np.random.default_rng(1), 500)
    moved = seen_px(PLACE_PX, DISTANCE_M, pose)
    found = poses(geometry(), moved, np.full(moved.shape, NOISE_PX**2))
    np.testing.assert_allclose(found.value[:, :3], pose[:, :3], atol=1e-9)
    np.testing.assert_allclose(found.value[:, 3:], pose[:, 3:], atol=1e-9)


def test_errors_are_at_the_bound_and_as_stated():
    rng = np.random.default_rng(2)
    pose = drawn(rng, 4000)
    moved = seen_px(PLACE_PX, DISTANCE_M, pose) + rng.normal(0.0, NOISE_PX, (len(pose), 3, 2))
    found = poses(geometry(), moved, np.full(moved.shape, NOISE_PX**2))
    error = found.value - pose
    least = bound(PLACE_PX, DISTANCE_M, NOISE_PX)
    # Some µm and some hundredths of a millidegree.
    assert np.all(least[:3] < 2e-5)
    assert np.all(np.degrees(least[3:]) < 2e-4)
    assert np.all(np.std(error, axis=0) < 1.1 * least)
    std = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    share = np.mean(np.abs(error) < 1.96 * std, axis=0)
    assert np.all((share > 0.93) & (share < 0.97))


def test_targets_that_are_not_seen_drop_out():
    place_px = np.vstack((PLACE_PX, [-300.0, 500.0]))
    distance_m = np.append(DISTANCE_M, 25.0)
    pose = drawn(np.random.default_rng(3), 4)
    moved = seen_px(place_px, distance_m, pose)
    variance = np.full(moved.shape, NOISE_PX**2)
    moved[1, 0], variance[2, 3, 0] = np.nan, np.inf
    moved[3, :2] = np.nan
    found = poses(geometry(place_px, distance_m), moved, variance)
    np.testing.assert_allclose(found.value[:3], pose[:3], atol=1e-8)
    assert list(found.spare[:3]) == [2.0, 0.0, 0.0]
    assert np.isnan(found.value[3]).all()
    assert np.isinf(found.covariance[3]).all()
    assert np.all(np.diagonal(found.covariance[1]) > np.diagonal(found.covariance[0]))


@pytest.mark.parametrize(
    ("place_px", "distance_m", "worst"),
    [
        (PLACE_PX, (10.0, 10.0, 10.0), [0, 1, 3, 4]),
        # On one line in space.
        ([[-500.0, -500.0], [0.0, 0.0], [500.0, 500.0]], 1.0 / np.array([0.3, 0.2, 0.1]), [0, 1, 3, 4]),
    ],
)
def test_degrees_that_targets_do_not_tell_apart_have_a_large_inflation(place_px, distance_m, worst):
    variance = np.full((3, 2), NOISE_PX**2)
    assert np.all(inflation(geometry(), variance) < 5.0)
    assert np.all(inflation(geometry(place_px, distance_m), variance)[worst] > 20.0)


def test_errors_of_the_geometry_show_in_the_pose_as_said():
    pose, variance = drawn(np.random.default_rng(4), 50), np.full((3, 2), NOISE_PX**2)
    slopes = by_geometry(geometry(), pose, variance)
    moved = seen_px(PLACE_PX, DISTANCE_M, pose)
    for number, other in enumerate(
        [Geometry(np.full(2, FOCAL_PX * 1.0001), PLACE_PX, 1.0 / DISTANCE_M)]
        + [Geometry(np.full(2, FOCAL_PX), PLACE_PX, 1.0 / DISTANCE_M + 1e-4 * row) for row in np.eye(3)]
    ):
        change = poses(other, moved, np.broadcast_to(variance, moved.shape)).value - pose
        np.testing.assert_allclose(change, 1e-4 * slopes[..., number], atol=1e-7, rtol=5e-2)


def test_rotation_vectors_come_back():
    vector = np.vstack((np.zeros((1, 3)), np.random.default_rng(5).uniform(-0.5, 0.5, (20, 3))))
    np.testing.assert_allclose(rotation_vector(rotated(vector)), vector, atol=1e-14)
    np.testing.assert_allclose(rotated(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)
