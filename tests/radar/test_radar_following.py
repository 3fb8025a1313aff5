"""Targets that move through several range bins: followed, what is static taken out of each bin, one factor."""

import numpy as np
import pytest
from radar_cases import SHORT, accelerometer, profiles_of

from midspan.errors import UntrustedError, UsageError
from midspan.radar.following import at_place, at_places, bins_within, places_of, response, static_in_bins
from midspan.radar.measurement import TargetFrames, displacement
from midspan.radar.range_profile import bin_kernel
from midspan.radar.target import Target, find_targets, ranked
from midspan.simulate.motion.motion import Sines
from midspan.simulate.radar.signal import RadarModel, Reflector, beat, noise_for, phase_bound_m

WALL_M, FACTOR, FRAMES = 1.318, 1.2748, 2000
UNIT = SHORT.phase_per_m(WALL_M)


def scene(amplitude_m: float, plate: float = 0.1):
    """Frames, profiles, samples and true displacement of a wall with a plate of a share `plate` in its bin."""
    motion = Sines(np.array([amplitude_m]), np.array([0.5]))
    view = (Reflector(WALL_M, 1000.0, 1 / FACTOR), Reflector(WALL_M + 0.02, 1000.0 * plate, 0.0))
    model = RadarModel(view, SHORT, noise_for(1000.0, 20.0))
    at = model.frame_s(FRAMES)
    return at, profiles_of(model, motion, FRAMES), accelerometer(motion, 20.0), motion.displacement(at)


@pytest.mark.parametrize("distance", [0.0, 0.3, 0.5, 1.0, 1.5, -0.7])
def test_the_response_is_that_of_the_window(distance: float) -> None:
    echo = beat(np.array([20 * SHORT.bin_m]), SHORT)[0]
    whole = np.abs(bin_kernel(np.array([20.0, 20.0 + distance]), SHORT) @ echo)
    # The window is sampled: 256 points instead of an integral.
    assert response(np.array(distance)) == pytest.approx(whole[1] / whole[0], abs=1e-3)


def test_phasors_at_moving_places_keep_amplitude_and_phase() -> None:
    moved = np.linspace(-0.08, 0.08, 400)
    echo = beat(WALL_M + moved, SHORT)
    place = WALL_M / SHORT.bin_m
    bins = bins_within(place, 0.08 / SHORT.bin_m)
    z = echo @ bin_kernel(bins, SHORT).T
    places = places_of(z, bins, place_bin=place + 0.4, moved_bins=moved / SHORT.bin_m)
    # Found on steps of a sixteenth of a bin.
    np.testing.assert_allclose(places, place + moved / SHORT.bin_m, atol=0.04)
    seen = at_places(z, bins, places)
    np.testing.assert_allclose(np.abs(seen), 1.0, atol=0.01)
    error = np.unwrap(np.angle(seen * np.exp(-1j * UNIT * moved)))
    assert np.ptp(error) / UNIT < 2e-6


def test_what_stands_still_is_found_in_every_bin_under_a_target_that_turns() -> None:
    moved = 0.04 * np.sin(np.linspace(0, 30, 3000))
    place = WALL_M / SHORT.bin_m
    bins = bins_within(place, 0.04 / SHORT.bin_m)
    kernel = bin_kernel(bins, SHORT)
    still = 0.1 * (kernel @ beat(np.array([WALL_M + 0.02]), SHORT)[0])
    z = beat(WALL_M + moved, SHORT) @ kernel.T + still
    found = static_in_bins(z, bins, place + moved / SHORT.bin_m)
    near = np.abs(bins - place) < 1.5
    np.testing.assert_allclose(found.phasors[near], still[near], atol=0.004)
    assert found.at(np.array([bins[-1] + 5.0]))[0] == 0


@pytest.mark.parametrize("amplitude", [0.03, 0.1])
def test_a_motion_of_a_bin_and_more_is_measured_to_the_noise_in_spite_of_a_plate_in_the_bin(amplitude: float) -> None:
    at, profiles, samples, true = scene(amplitude)
    targets = find_targets(profiles, at, samples=samples, axis=SHORT.axis)
    target = ranked(targets)[0]
    assert target.conversion_factor == pytest.approx(FACTOR, rel=1e-4)
    assert target.range_m == pytest.approx(WALL_M, abs=0.15 * SHORT.bin_m)
    assert target.reach_bins == pytest.approx(amplitude / FACTOR / SHORT.bin_m, rel=0.1)
    valid, bins = np.ones((FRAMES, 4), dtype=bool), target.bins(0.0, SHORT.bin_m)
    frames = TargetFrames(at, profiles[:, :, bins.astype(int)], valid, bins, SHORT.bin_m)
    series = displacement(frames, target, samples=samples, phase_per_m=UNIT)
    assert np.isfinite(series.value_m).all()
    assert series.restarts == ()
    error = series.value_m - true
    bound = FACTOR * phase_bound_m(20.0, SHORT, 4)
    # The window costs 1.22, interpolating between bins up to 1.08 more, the factor's error 1e-5 of the motion;
    # the plate alone would make 20 µm.
    assert np.std(error) < 1.6 * bound + 2e-5 * np.std(true)


def test_without_following_a_large_motion_leaves_its_bin() -> None:
    at, profiles, samples, true = scene(0.1, plate=0.0)
    target = ranked(find_targets(profiles, at, samples=samples, axis=SHORT.axis))[0]
    frames = TargetFrames(at, at_place(profiles, target.place_bin), np.ones((FRAMES, 4), dtype=bool))
    series = displacement(frames, target, samples=samples, phase_per_m=UNIT)
    assert np.mean(np.isfinite(series.value_m)) < 0.8
    assert np.ptp(true) > 0.19


def test_a_second_record_whose_calibration_moved_little_is_followed_all_the_same() -> None:
    at, profiles, samples, _ = scene(2e-3, plate=0.0)
    target = ranked(find_targets(profiles, at, samples=samples, axis=SHORT.axis))[0]
    assert target.background is None
    at, profiles, samples, true = scene(0.05)
    bins = target.bins(0.05 / FACTOR, SHORT.bin_m)
    frames = TargetFrames(at, profiles[:, :, bins.astype(int)], np.ones((FRAMES, 4), dtype=bool), bins, SHORT.bin_m)
    series = displacement(frames, target, samples=samples, phase_per_m=UNIT)
    error = series.value_m - true
    # The factor is known to 0.01 % from 2 mm: 3 µm of 35 mm rms.
    assert np.std(error) < 1.6 * FACTOR * phase_bound_m(20.0, SHORT, 4) + 2 * target.relative_std * np.std(true)


def test_bins_that_do_not_fit_the_phasors_and_targets_without_a_factor_are_refused() -> None:
    at = np.arange(100) / 100
    blank = Target(20.0, 1.1, 1.0, 20.0, np.ones(1, dtype=complex), 0.0)
    frames = TargetFrames(at, np.ones((100, 1), dtype=complex), np.ones((100, 1), dtype=bool))
    with pytest.raises(UntrustedError, match="does not follow the accelerometer"):
        displacement(frames, blank, samples=np.zeros((100, 2)), phase_per_m=UNIT)
    good = Target(20.0, 1.1, 1.0, 20.0, np.ones(1, dtype=complex), 0.0, conversion_factor=1.0)
    wrong = TargetFrames(at, frames.phasors, frames.valid, np.arange(3.0), SHORT.bin_m)
    with pytest.raises(UsageError, match="bins"):
        displacement(wrong, good, samples=np.zeros((100, 2)), phase_per_m=UNIT)
