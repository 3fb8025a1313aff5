"""A gyroscope on a camera's box: focal length and scale, by a bridge, a bracket and a sun in formulas."""

from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from midspan.calibration.camera.calibrate import SLOW_TILT, fit_camera
from midspan.calibration.camera.gyroscope import BIAS_STD, BIAS_WALK, fit_gyroscope
from midspan.calibration.camera.turning import noise_floor
from midspan.calibration.camera.view import SeenTarget, View, camera_pair, scale_of
from midspan.calibration.fit import best_corner
from midspan.errors import UntrustedError
from midspan.records import PixelTrack, Region, TimeSeries
from midspan.signals.acceleration import prepare_acceleration

FOCAL_PX = 5000.0
MDEG = float(np.radians(1e-3))
# Slope over displacement of a span of 45 m at its quarter, rad/m.
SLOPE = np.pi / 45.0
FRAMES_LATE_S = 0.03
# A gyroscope's noise, rad/s/√Hz, one-sided.
DENSITY = float(np.radians(0.005))


@dataclass(frozen=True)
class Site:
    """What differs between records."""

    seed: int = 0
    duration_s: float = 100.0
    frames_hz: float = 10.0
    distances_m: tuple[float, ...] = (3.0,)
    density: float = DENSITY
    gyroscope_hz: float = 200.0
    late_s: float = 0.0
    bias: float = float(np.radians(0.3))
    slope: float = SLOPE
    bracket: float = 1.5 * MDEG
    sun: float = 5.0 * MDEG
    max_offset_s: float = 0.1


class Tones:
    """A narrow band of many tones."""

    def __init__(self, rng, band, rms, count):
        self.omega = 2.0 * np.pi * rng.uniform(*band, count)
        size = rng.rayleigh(1.0, count)
        self.size = size * rms / np.sqrt(0.5 * np.sum(size**2)) if rms else 0.0 * size
        self.phase = rng.uniform(0.0, 2.0 * np.pi, count)

    def __call__(self, time_s, order):
        phases = np.outer(time_s, self.omega) + self.phase + 0.5 * np.pi * order
        return np.sin(phases) @ (self.size * self.omega**order)


def walker(time_s, order, at_s, depth_m=-2e-3, wide_s=3.0):
    """Someone who crosses, or a derivative of that."""
    u = (time_s - at_s) / wide_s
    return depth_m * np.exp(-0.5 * u * u) * (1.0, -u / wide_s, (u * u - 1.0) / wide_s**2)[order]


def stamps(time_s):
    """Seconds as nanoseconds."""
    return np.rint(time_s * 1e9).astype(np.int64)


def target(name, time_s, value, variance):
    """A target as it was tracked along y."""
    n = len(time_s)
    nothing, noise = np.zeros(n), np.full(n, variance)
    rows = PixelTrack(
        stamps(time_s), nothing, value, noise, noise, np.ones(n), np.zeros(n, np.uint8), nothing, np.full(n, np.inf)
    )
    tracker = SimpleNamespace(scale_share_std=0.0, phase_gain_px_per_rad=None)
    figures = (np.zeros((n, 2)), 0.0, None, tracker, "registration", None, None, (1920, 1080))
    return SeenTarget(name, Region(0, 0, 64, 64), rows, *figures)


@cache
def recorded(site):
    """View, targets and gyroscope of a camera that looks along a bridge."""
    rng = np.random.default_rng(site.seed)
    modes = (Tones(rng, (2.05, 2.15), 1e-3, 40), Tones(rng, (5.9, 6.1), 0.05e-3, 40))
    bracket, sun = Tones(rng, (3.3, 3.7), site.bracket, 20), Tones(rng, (1 / 170, 1 / 170), site.sun, 1)
    crossings = [at_s + rng.uniform(-4.0, 4.0) for at_s in (20.0, 50.0, 80.0)]

    def moved(time_s, order, late_s=0.0):
        parts = (walker(time_s, order, at_s + late_s) for at_s in crossings)
        return sum(mode(time_s, order) for mode in modes) + sum(parts)

    def turned(time_s, order):
        # The slope under walkers comes later than they sink in.
        return site.slope * moved(time_s, order, 2.0) + bracket(time_s, order) + sun(time_s, order)

    felt_s = np.arange(0.0, site.duration_s, 0.01)
    felt = moved(felt_s, 2) + rng.normal(0.02, 1e-3, len(felt_s))
    gyroscope_s = np.arange(0.0, site.duration_s, 1.0 / site.gyroscope_hz)
    noise = site.density * np.sqrt(0.5 * site.gyroscope_hz)
    rate = turned(gyroscope_s, 1) + rng.normal(site.bias, noise, len(gyroscope_s))
    seen_s = np.arange(0.2, site.duration_s - 0.2, 1.0 / site.frames_hz)
    targets = []
    for number, distance_m in enumerate(site.distances_m):
        value = FOCAL_PX * (moved(seen_s, 0) / distance_m + turned(seen_s, 0)) + rng.normal(0.0, 0.01, len(seen_s))
        targets.append(target(str(number), seen_s - FRAMES_LATE_S, value, 1e-4))
    prepared = prepare_acceleration(TimeSeries(stamps(felt_s), felt), "accelerometer")
    view = View("y", prepared, slice(0, len(felt_s)), site.max_offset_s)
    return view, tuple(targets), TimeSeries(stamps(gyroscope_s + site.late_s), rate)


def changed(series, which, value):
    """The series with other readings somewhere."""
    readings = series.value.copy()
    readings[which] = value
    return replace(series, value=readings)


def off(found, site=Site(), number=0):
    """A scale factor's relative error and standard deviation."""
    true = site.distances_m[number] / FOCAL_PX
    return found.value_m_per_px / true - 1.0, np.sqrt(found.variance) / true


def check_right(found, site=Site(), vague=0.05):
    """Focal length and scale are within their bands, which are narrow."""
    assert abs(found.focal_px - FOCAL_PX) < 3.0 * found.focal_std_px
    error, std = off(found.scales[0], site)
    assert abs(error) < 3.0 * std < vague


@pytest.mark.parametrize(
    ("distance_m", "frames_hz", "seed"),
    [(3.0, 10.0, 0), (3.0, 10.0, 1), (10.0, 10.0, 0), (10.0, 10.0, 1), (3.0, 30.0, 0), (10.0, 30.0, 1)],
)
def test_focal_length_and_scale_are_right_where_the_slope_goes_with_the_displacement(distance_m, frames_hz, seed):
    site = Site(seed, frames_hz=frames_hz, distances_m=(distance_m,))
    view, targets, gyroscope = recorded(site)
    found = fit_gyroscope(view, targets, gyroscope, noise_density=site.density)
    check_right(found, site)
    assert abs(found.focal_px / FOCAL_PX - 1.0) < 0.03
    assert found.focal_std_px < 0.025 * FOCAL_PX
    assert abs(found.offset_s) < 3.0 * found.offset_std_s < 0.01
    # Without the gyroscope the slope counts as displacement.
    alone = FOCAL_PX / distance_m / best_corner(camera_pair(view, targets[0].rows, 0.0), FRAMES_LATE_S).ratio
    assert alone == pytest.approx(1.0 / (1.0 + SLOPE * distance_m), abs=0.15)
    assert abs(off(found.scales[0], site)[0]) < 0.1 * abs(alone - 1.0)


def test_errors_are_as_large_as_their_standard_deviations():
    standard = []
    for seed in range(10, 16):
        site = Site(seed, duration_s=60.0)
        view, targets, gyroscope = recorded(site)
        found = fit_gyroscope(view, targets, gyroscope)
        error, std = off(found.scales[0])
        late = found.offset_s / found.offset_std_s
        standard.append(((found.focal_px - FOCAL_PX) / found.focal_std_px, error / std, late))
    rms = np.sqrt(np.mean(np.square(standard), axis=0))
    assert (rms > 0.3).all()
    assert (rms < 1.6).all()


def test_noise_bias_and_tilt_are_those_of_the_gyroscope():
    view, targets, gyroscope = recorded(Site())
    found = fit_gyroscope(view, targets, gyroscope)
    assert found.noise_rad_s == pytest.approx(DENSITY * np.sqrt(100.0), rel=0.1)
    assert abs(found.bias_rad_s - np.radians(0.3)) < 3.0 * found.bias_std_rad_s < 0.01 * BIAS_STD
    assert found.bias_walk == BIAS_WALK
    tilt_px = FOCAL_PX * np.hypot(SLOPE * 1e-3, 1.5 * MDEG)
    assert found.tilt_std_px == pytest.approx(tilt_px, rel=0.2)
    assert found.slow_tilt_px == SLOW_TILT * found.tilt_std_px
    assert [one.code for one in found.notices] == ["tilt"]


@pytest.mark.parametrize("share", [0.6, 1.6])
def test_a_noise_density_that_is_declared_wrong_changes_little(share):
    view, targets, gyroscope = recorded(Site(3))
    found = fit_gyroscope(view, targets, gyroscope, noise_density=share * DENSITY)
    check_right(found, Site(3))
    assert found.noise_rad_s > 0.9 * DENSITY * np.sqrt(100.0)


def test_a_gyroscope_of_a_phone_is_enough_within_its_band():
    site = Site(1, density=float(np.radians(0.014)))
    # Its noise is 2.8 times as large, that of the scale factor 1.2 times.
    check_right(fit_gyroscope(*recorded(site)), replace(site), vague=0.06)


def test_two_targets_have_one_focal_length_and_scales_as_their_distances():
    site = Site(3, distances_m=(3.0, 10.0))
    found = fit_gyroscope(*recorded(site))
    check_right(found, site)
    error, std = off(found.scales[1], site, 1)
    assert abs(error) < 3.0 * std < 0.06
    assert found.reasons == ("", "")


def test_a_target_that_cannot_be_calibrated_leaves_the_others():
    view, targets, gyroscope = recorded(Site())
    still = targets[0].rows
    still = replace(still, y_px=np.random.default_rng(0).normal(0.0, 0.01, len(still.time_ns)))
    found = fit_gyroscope(view, (targets[0], replace(targets[0], name="still", rows=still)), gyroscope)
    check_right(found)
    assert found.scales[1] is None
    assert "turns with the camera" in found.reasons[1]


def test_the_clock_offset_of_a_camera_that_is_calibrated_is_taken():
    site = Site()
    view, targets, gyroscope = recorded(site)
    fits = fit_camera([view], targets, lambda: ())
    found = fit_gyroscope(view, targets, gyroscope, fits)
    check_right(found)
    assert found.found[0].search.offset.value_s == pytest.approx(FRAMES_LATE_S, abs=1e-3)
    late = replace(view, late_ns=20_000_000)
    again = fit_gyroscope(late, targets, gyroscope, fits)
    assert again.focal_px == pytest.approx(found.focal_px, rel=0.01)


def test_a_camera_that_the_accelerometer_alone_refuses_is_calibrated():
    site = Site(frames_hz=30.0)
    view, targets, gyroscope = recorded(site)
    with pytest.raises(UntrustedError, match="No agreement"):
        fit_camera([view], targets, lambda: ())
    found = fit_gyroscope(view, targets, gyroscope)
    (camera,) = fit_camera([view], targets, lambda: (), without_tilt={"y": found.fitted})
    error, std = off(camera.calibration.scale)
    assert abs(error) < 3.0 * std < 0.03
    assert camera.calibration.offset.value_s == pytest.approx(FRAMES_LATE_S, abs=1e-3)
    assert camera.calibration.noise_std_px < 0.02


def test_the_gyroscope_decides_between_two_clock_offsets():
    site = Site(1, distances_m=(10.0,), max_offset_s=0.5)
    view, targets, gyroscope = recorded(site)
    with pytest.raises(UntrustedError, match="ambiguous"):
        scale_of(view, camera_pair(view, targets[0].rows, 0.0))
    found = fit_gyroscope(view, targets, gyroscope)
    check_right(found, site)
    assert found.found[0].search.offset.value_s == pytest.approx(FRAMES_LATE_S, abs=3e-3)


@pytest.mark.parametrize("late_s", [0.02, -0.05])
def test_a_late_clock_is_found(late_s):
    site = Site(3, late_s=late_s)
    found = fit_gyroscope(*recorded(site))
    check_right(found, site)
    assert abs(found.offset_s + late_s) < 3.0 * found.offset_std_s < 0.01


def test_a_large_bias_changes_nothing():
    view, targets, gyroscope = recorded(Site())
    found = fit_gyroscope(view, targets, gyroscope)
    shifted = fit_gyroscope(view, targets, replace(gyroscope, value=gyroscope.value + np.radians(3.0)))
    assert shifted.focal_px == pytest.approx(found.focal_px, rel=1e-6)
    assert shifted.bias_rad_s - found.bias_rad_s == pytest.approx(np.radians(3.0))


def test_a_bias_that_drifts_is_in_its_band():
    view, targets, gyroscope = recorded(Site())
    drift = np.linspace(0.0, np.radians(0.5), len(gyroscope.value))
    found = fit_gyroscope(view, targets, replace(gyroscope, value=gyroscope.value + drift))
    check_right(found)
    # It is the mean's at first and last within the band, and drifts on.
    assert 0.45 * np.radians(0.25) < found.bias_std_rad_s < np.radians(0.25)
    assert found.bias_walk * 100.0 == pytest.approx(3.0 * np.radians(0.25) ** 2, rel=0.1)


def test_a_lens_makes_the_focal_length_sharper():
    view, targets, gyroscope = recorded(Site())
    alone = fit_gyroscope(view, targets, gyroscope)
    both = fit_gyroscope(view, targets, gyroscope, focal_px=(5050.0, 60.0))
    assert both.focal_std_px < min(alone.focal_std_px, 60.0)
    assert min(alone.focal_px, 5050.0) < both.focal_px < max(alone.focal_px, 5050.0)
    check_right(both)
    assert off(both.scales[0])[1] < off(alone.scales[0])[1]


def test_a_lens_decides_where_nothing_but_the_slope_turns_the_camera():
    site = Site(1, bracket=0.0)
    view, targets, gyroscope = recorded(site)
    with pytest.raises(UntrustedError, match=r"rotates too little.*Give camera\.lens"):
        fit_gyroscope(view, targets, gyroscope)
    found = fit_gyroscope(view, targets, gyroscope, focal_px=(5000.0, 50.0))
    assert (found.focal_px, found.focal_std_px) == (5000.0, 50.0)
    check_right(found, site)


def test_a_camera_that_does_not_turn_keeps_its_scale():
    site = Site(2, bracket=0.0, slope=0.0, sun=0.0)
    view, targets, gyroscope = recorded(site)
    with pytest.raises(UntrustedError, match="rotates too little"):
        fit_gyroscope(view, targets, gyroscope)
    check_right(fit_gyroscope(view, targets, gyroscope, focal_px=(5000.0, 50.0)), site)


@pytest.mark.parametrize(
    ("factor", "focal_px", "said"),
    [
        (-1.0, None, "wrong sign"),
        (-1.0, (5000.0, 50.0), "wrong sign"),
        (np.degrees(1.0), None, "implausible. Check gyroscope.unit"),
        (np.degrees(1.0), (5000.0, 50.0), "by camera.lens 5000 ± 50 px. Check gyroscope.unit"),
        (np.radians(1.0), None, "implausible. Check gyroscope.unit"),
        (np.radians(1.0), (5000.0, 50.0), "deg/s and rad/s differ by a factor of 57.3"),
        (1.0, (6000.0, 50.0), "by camera.lens 6000 ± 50 px"),
    ],
)
def test_a_wrong_sign_unit_or_lens_is_named(factor, focal_px, said):
    view, targets, gyroscope = recorded(Site())
    turned = replace(gyroscope, value=factor * gyroscope.value)
    with pytest.raises(UntrustedError, match=said):
        fit_gyroscope(view, targets, turned, focal_px=focal_px)


@pytest.mark.parametrize("focal_px", [None, (5000.0, 50.0)])
def test_a_wrong_axis_is_named(focal_px):
    view, targets, _ = recorded(Site())
    *_, other = recorded(Site(11))
    with pytest.raises(UntrustedError, match=r"does not show the rotation.*permuted"):
        fit_gyroscope(view, targets, other, focal_px=focal_px)


@pytest.mark.parametrize("which", [slice(0, 1000), slice(19_000, None), slice(12_000, None)])
def test_readings_that_begin_late_or_end_early_are_enough(which):
    view, targets, gyroscope = recorded(Site(3))
    kept = np.delete(np.arange(len(gyroscope.value)), which)
    cut = replace(gyroscope, time_ns=gyroscope.time_ns[kept], value=gyroscope.value[kept])
    check_right(fit_gyroscope(view, targets, cut), Site(3))


@pytest.mark.parametrize("kind", ["missing", "frozen", "hole"])
def test_frames_in_a_gap_are_not_used(kind):
    view, targets, gyroscope = recorded(Site(3))
    gone = slice(4000, 5000)
    if kind == "hole":
        kept = np.r_[0 : gone.start, gone.stop : len(gyroscope.value)]
        damaged = replace(gyroscope, time_ns=gyroscope.time_ns[kept], value=gyroscope.value[kept])
    else:
        damaged = changed(gyroscope, gone, np.nan if kind == "missing" else gyroscope.value[gone.start])
    found = fit_gyroscope(view, targets, damaged)
    check_right(found, Site(3))
    assert [one.code for one in found.notices] == ["tilt", "samples-bridged"]
    rows = found.found[0].search.pair.rows
    inside = (rows[:, 0] + FRAMES_LATE_S > 20.1) & (rows[:, 0] + FRAMES_LATE_S < 24.9)
    assert np.isinf(rows[inside, 2]).all()
    assert np.mean(np.isinf(rows[~inside, 2])) < 0.02


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda value: np.zeros(len(value)), "all readings .* are equal"),
        (lambda value: np.where(np.arange(len(value)) < 8000, value[0], value), "missing or frozen for 40 %"),
        (lambda value: np.clip(value, *(np.mean(value) + 1.5 * np.std(value) * np.array([-1, 1]))), "are clipped"),
        (lambda value: np.full(len(value), np.nan), "no reading lies in the calibration window"),
    ],
)
def test_readings_of_no_use_are_refused(spoil, said):
    view, targets, gyroscope = recorded(Site())
    with pytest.raises(UntrustedError, match=said):
        fit_gyroscope(view, targets, replace(gyroscope, value=spoil(gyroscope.value)))


def test_readings_of_another_time_or_a_low_rate_are_refused():
    view, targets, gyroscope = recorded(Site())
    with pytest.raises(UntrustedError, match="no reading lies in the calibration window"):
        fit_gyroscope(view, targets, replace(gyroscope, time_ns=gyroscope.time_ns + 10**12))
    slow = replace(gyroscope, time_ns=gyroscope.time_ns[::20], value=gyroscope.value[::20])
    with pytest.raises(UntrustedError, match="10 readings a second are too few"):
        fit_gyroscope(view, targets, slow)


def test_a_few_clipped_crests_are_reported():
    view, targets, gyroscope = recorded(Site(3))
    limit = 3.2 * np.std(gyroscope.value) * np.array([-1.0, 1.0])
    found = fit_gyroscope(
        view, targets, replace(gyroscope, value=np.clip(gyroscope.value, *np.mean(gyroscope.value) + limit))
    )
    check_right(found, Site(3))
    assert any("clipped" in one for one in found.notices)


def test_occluded_and_wrong_frames_change_little():
    view, targets, gyroscope = recorded(Site())
    rng, rows = np.random.default_rng(5), targets[0].rows
    place, variance = rows.y_px.copy(), rows.variance_y_px2.copy()
    wrong = rng.random(len(place)) < 0.04
    place[wrong] += rng.choice([-1.0, 1.0], wrong.sum()) * rng.uniform(3.0, 30.0, wrong.sum())
    place[300:360], variance[300:360] = np.nan, np.inf
    spoilt = replace(targets[0], rows=replace(rows, y_px=place, variance_y_px2=variance))
    check_right(fit_gyroscope(view, (spoilt,), gyroscope))


def test_a_band_of_the_acceleration_decides():
    view, targets, gyroscope = recorded(Site())
    check_right(fit_gyroscope(replace(view, band_hz=(1.0, 4.5)), targets, gyroscope))


def test_targets_that_are_not_seen_are_refused():
    view, targets, gyroscope = recorded(Site())
    rows = targets[0].rows
    gone = replace(targets[0], rows=replace(rows, y_px=np.full(len(rows.y_px), np.nan)))
    with pytest.raises(UntrustedError, match="Only 0 usable frames"):
        fit_gyroscope(view, (gone, gone), gyroscope)


def test_noise_is_read_where_there_is_no_motion():
    _, _, gyroscope = recorded(Site())
    found = noise_floor(gyroscope.value, 200.0)
    assert np.sqrt(2.0 * found) == pytest.approx(DENSITY, rel=0.1)
    time_s = np.arange(len(gyroscope.value)) / 200.0
    machine = 0.05 * np.sin(2.0 * np.pi * 31.0 * time_s)
    assert noise_floor(gyroscope.value + machine, 200.0) == pytest.approx(found, rel=0.1)
