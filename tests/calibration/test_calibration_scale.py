"""Scale factor and clock offset: right, honestly uncertain, unshrunk by noise, alias-exact, and refused where due."""

import re
from dataclasses import replace

import numpy as np
import pytest
from calibration_cases import OFFSET, SCALE, beam_in_pixels, broadband, observed, spoilt, tones

from midspan.calibration.fit import Pair
from midspan.calibration.scale import calibrate_scale, of_no_camera, too_vague, uncertain_scale
from midspan.calibration.time_offset import search_offset
from midspan.errors import NoAgreementError, UntrustedError
from midspan.simulate.motion.motion import Pulse, Sum, Window, random_motion
from repeats import slow


def deviations(results, scale=SCALE, offset=OFFSET):
    """Errors of scale and offset in units of their claimed standard deviation, each (n,)."""
    return (
        np.array([(r.scale.value_m_per_px - scale) / np.sqrt(r.scale.variance) for r in results]),
        np.array([(r.search.offset.value_s - offset) / np.sqrt(r.search.offset.variance) for r in results]),
    )


@pytest.mark.parametrize(
    ("kind", "rate_hz", "noise_px", "draws"),
    [
        ("broadband", 10.0, 0.02, 20),
        *slow(("tone", 29.97, 0.1, 40), ("broadband", 10.0, 0.02, 40), ("broadband", 29.97, 0.02, 40)),
    ],
)
def test_the_claimed_deviations_of_scale_and_offset_are_honest(kind, rate_hz, noise_px, draws):
    results = []
    for seed in range(draws):
        motion = tones(seed, (4.2e-3, 1.0)) if kind == "tone" else broadband(seed)
        pair = observed(motion, 500 + seed, rate_hz=rate_hz, noise_px=noise_px)
        results.append(calibrate_scale(pair, 0.15))
    for z in deviations(results):
        # 40 draws: the deviation of z is known to ± 11 %, its mean to ± 0.16; fewer draws: as their root.
        scatter = np.sqrt(40 / draws)
        assert abs(np.std(z) - 1.0) < 0.3 * scatter
        assert abs(np.mean(z)) < 0.4 * scatter
    noise = np.array([r.noise.std for r in results])
    assert np.mean(noise) == pytest.approx(noise_px, rel=0.03)


def naive_scale(pair):
    """Least squares of twice integrated acceleration on the translation, both in a band, at the true offset."""
    time, value = pair.samples[:, 0], pair.samples[:, 1]
    frequency = np.fft.rfftfreq(len(value), 0.01)
    in_band = (frequency > 0.5) & (frequency < 5.0)
    response = np.where(in_band, -1.0 / (2 * np.pi * np.where(in_band, frequency, 1.0)) ** 2, 0.0)
    moved = np.fft.irfft(np.fft.rfft(value) * response, len(value))
    seen = np.interp(time, pair.rows[:, 0] + OFFSET, pair.rows[:, 1])
    seen = np.fft.irfft(np.fft.rfft(seen) * in_band, len(value))
    inner = slice(500, -500)
    return float(moved[inner] @ seen[inner] / (seen[inner] @ seen[inner]))


def test_pixel_noise_does_not_shrink_the_scale_as_least_squares_on_pixels_does():
    # 1 Hz of 3 mm rms, 0.5 px of noise at 29.97 Hz: in the band 0.5 to 5 Hz the noise is 4 % of the power.
    pairs = [observed(tones(s, (4.2e-3, 1.0)), 700 + s, rate_hz=29.97, noise_px=0.5) for s in range(12)]
    results = [calibrate_scale(pair, 0.15) for pair in pairs]
    naive = np.array([naive_scale(pair) for pair in pairs]) / SCALE - 1.0
    ours = np.array([r.scale.value_m_per_px for r in results]) / SCALE - 1.0
    std = np.mean([np.sqrt(r.scale.variance) for r in results]) / SCALE
    assert np.mean(naive) < -0.02
    # The mean of twelve is known to 0.29 of their deviation, which is far below what the noise would take.
    assert abs(np.mean(ours)) < 0.6 * std
    assert std < 0.015


@pytest.mark.parametrize(
    ("seed", "offset_s"),
    [(21, -0.2), (22, 0.0), (23, 0.2), *slow((21, 0.0), (21, 0.2), (22, -0.2), (22, 0.2), (23, -0.2), (23, 0.0))],
)
def test_beam_gives_scale_within_three_per_mille_and_offset_within_a_millisecond(seed, offset_s):
    found = calibrate_scale(beam_in_pixels(seed, offset_s), 0.5)
    assert found.scale.value_m_per_px == pytest.approx(-SCALE, rel=3e-3)
    assert found.search.offset.value_s == pytest.approx(offset_s, abs=1e-3)
    assert not found.warnings


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_sign_of_the_scale_is_found(sign):
    found = calibrate_scale(observed(broadband(31), 31, scale=sign * SCALE), 0.5)
    assert found.scale.value_m_per_px == pytest.approx(sign * SCALE, rel=5e-3)
    # The mirrored motion with the mirrored scale is the same problem.
    pair = observed(broadband(31), 31, scale=sign * SCALE)
    mirrored = Pair(pair.samples, pair.rows * [1.0, -1.0, 1.0])
    other = calibrate_scale(mirrored, 0.5)
    assert other.scale.value_m_per_px == pytest.approx(-found.scale.value_m_per_px, rel=1e-9)


@pytest.mark.parametrize(
    ("frequency", "seed"), [(2.2, 41), (3.3, 42), (5.1, 41), *slow((2.2, 42), (3.3, 41), (5.1, 42))]
)
def test_a_camera_of_three_hertz_that_aliases_the_motion_is_calibrated(frequency, seed):
    # 3.3 Hz looks like 0.3 Hz and the lag like eleven times itself, so a resampling method fails by 100 ms.
    found = calibrate_scale(observed(tones(seed, (8e-3, 0.1), (3e-3, frequency)), seed, rate_hz=3.0), 0.08)
    assert found.scale.value_m_per_px == pytest.approx(SCALE, rel=0.012)
    assert found.search.offset.value_s == pytest.approx(OFFSET, abs=1e-3)
    for z in deviations([found]):
        assert abs(z[0]) < 3.5


def test_a_tones_alias_does_not_hide_in_the_slow_band_when_the_search_is_wide():
    # Within ± 0.5 s a 3.3 Hz tone has three periods; the 0.1 Hz part and the sampling tell which one is right.
    found = calibrate_scale(observed(tones(43, (8e-3, 0.1), (3e-3, 3.3)), 43, rate_hz=3.0), 0.5)
    assert found.search.offset.value_s == pytest.approx(OFFSET, abs=1e-3)


@pytest.mark.parametrize(
    ("seed", "rate_hz"), [(0, 10.0), (1, 29.97), *slow(*((s, hz) for s in range(4) for hz in (10.0, 29.97)))]
)
def test_mistracked_frames_move_scale_and_offset_by_less_than_their_deviation(rate_hz, seed):
    clean = observed(broadband(seed), 60 + seed, rate_hz=rate_hz)
    dirty, bad = spoilt(clean, 80 + seed)
    expected, found = calibrate_scale(clean, 0.5), calibrate_scale(dirty, 0.5)
    assert abs(found.scale.value_m_per_px - expected.scale.value_m_per_px) < np.sqrt(expected.scale.variance)
    moved_s = found.search.offset.value_s - expected.search.offset.value_s
    assert abs(moved_s) < np.sqrt(expected.search.offset.variance)
    assert found.scale.variance < 1.3 * expected.scale.variance
    left_out = ~np.isfinite(found.search.pair.rows[:, 2])
    assert np.all(left_out[bad])
    assert np.count_nonzero(left_out & ~bad) <= 0.01 * len(bad)


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_a_vehicle_in_a_quiet_minute_is_no_outlier(seed):
    shaking = random_motion((2.0, 6.0), 5e-4, rng=np.random.default_rng(seed))
    motion = Window(Sum((Pulse(3e-3, 30.0, 1.0), shaking)), 28.0, 32.0, ramp_s=1.0)
    found = calibrate_scale(observed(motion, seed), 0.5)
    passing = np.abs(found.search.pair.rows[:, 0] - 30.0) < 2.0
    assert np.mean(np.isfinite(found.search.pair.rows[passing, 2])) > 0.75
    assert abs(found.scale.value_m_per_px - SCALE) < 3.0 * np.sqrt(found.scale.variance)


def refusal(pair, max_offset_s=0.5):
    with pytest.raises(UntrustedError) as caught:
        calibrate_scale(pair, max_offset_s)
    return f"{caught.value} {caught.value.more}"


def test_too_little_motion_is_refused_with_the_figures_and_what_to_do():
    text = refusal(observed(tones(1, (1e-7, 1.0)), 1))
    assert "Too little motion" in text
    assert "0.02" in text  # the pixels' noise
    assert "calibration.window_s" in text
    assert "-c" in text


def test_a_still_image_beside_a_shaken_accelerometer_is_refused():
    pair = observed(broadband(2), 2)
    rows = pair.rows.copy()
    rows[:, 1] = np.random.default_rng(2).normal(0, 0.02, len(rows))
    text = refusal(replace(pair, rows=rows))
    assert "Too little motion" in text or "No agreement" in text


@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3)])
def test_signals_of_different_events_do_not_agree(seed):
    pair, other = observed(broadband(seed), seed), observed(broadband(seed + 100), seed + 100)
    with pytest.raises(NoAgreementError):
        calibrate_scale(replace(pair, rows=other.rows), 0.5)
    text = refusal(replace(pair, rows=other.rows))
    assert "No agreement between image and accelerometer" in text
    assert "camera.direction" in text
    assert "calibration.max_offset_s" in text


def test_different_events_of_a_noisy_film_are_no_little_motion():
    pair, other = observed(broadband(0), 0, noise_px=0.3), observed(broadband(100), 100)
    text = refusal(replace(pair, samples=other.samples))
    assert "both move, but too differently" in text
    assert "both files are of the same event" in text
    assert "calibration.window_s with traffic" in text


def test_a_scale_factor_of_no_camera_is_no_figure():
    assert too_vague(4e-3, 0.47).startswith("4 mm/px ± 47 %")
    assert too_vague(-42.0, 0.47).startswith("an uncertainty of ± 47 %; at most ± 5 %")
    assert "more than 500 mm/px" in of_no_camera(-42.0)


def test_an_offset_outside_the_search_is_refused_not_misjudged():
    for offset_s in (0.4, -4.0):
        text = refusal(observed(broadband(3), 3, offset_s=offset_s), 0.1)
        assert f"within ±0.1 s: their clocks seem to differ by {offset_s:+.3g} s" in text


def test_a_single_tone_with_half_a_period_inside_the_search_is_ambiguous():
    # 5 Hz: 0.1 s later the motion is the same turned over, with the scale factor's sign turned as well.
    pair = observed(tones(5, (3e-3, 5.0)), 5, rate_hz=29.97)
    for max_offset_s in (0.5, 0.09):
        text = refusal(pair, max_offset_s)
        assert "ambiguous" in text
        assert f"±{max_offset_s:g} s" in text
        assert "calibration.max_offset_s" in text
        assert "2.29" in text
    # Clocks closer than a quarter of a period settle it.
    close = observed(tones(5, (3e-3, 5.0)), 5, rate_hz=29.97, offset_s=0.01)
    found = calibrate_scale(close, 0.04)
    assert found.search.offset.value_s == pytest.approx(0.01, abs=5e-4)
    assert found.scale.value_m_per_px == pytest.approx(SCALE, rel=3e-3)


def test_a_tone_whose_alias_falls_into_the_slow_band_is_refused_with_that_reason():
    # 3 Hz at 3 frames a second: every frame meets the same phase, and 3.01 Hz drifts through it once in 100 s.
    for frequency in (3.0, 3.01):
        text = refusal(observed(tones(44, (3e-3, frequency)), 44, rate_hz=3.0), 0.08)
        assert f"main tone of {frequency:.3g} Hz" in text
        assert "too slow to separate from drift" in text
    # The same motion is calibrated at another rate.
    found = calibrate_scale(observed(tones(44, (3e-3, 3.0)), 44, rate_hz=3.7), 0.06)
    assert found.scale.value_m_per_px == pytest.approx(SCALE, rel=0.012)


@pytest.mark.parametrize("draws", [12, *slow(24)])
def test_a_slow_tone_beside_an_alias_in_the_slow_band_is_calibrated_by_itself(draws):
    # 8 mm at 0.1 Hz tell the scale to 1 %, the offset to 18 ms; the tone that is static may not spoil either.
    results = [
        calibrate_scale(observed(tones(s, (8e-3, 0.1), (3e-3, 3.01)), 100 + s, rate_hz=3.0), 0.08) for s in range(draws)
    ]
    for z in deviations(results):
        # 24 draws: the rms of z is known to ± 14 %; 12 draws: to ± 20 %.
        assert 0.65 < np.sqrt(np.mean(z**2)) < 1.35


@pytest.mark.parametrize("draws", [12, *slow(24)])
def test_an_alias_upon_a_slower_tone_is_refused_or_right(draws):
    # 3.1 Hz shows as 0.1 Hz, where there is a true motion: amplitude and phase of the sum fit two scales.
    # Without `fit.shrinking` the smaller ratio won, four of its standard deviations off.
    results, refused = [], []
    for s in range(draws):
        try:
            pair = observed(tones(s, (8e-3, 0.1), (3e-3, 3.1)), 100 + s, rate_hz=3.0)
            results.append(calibrate_scale(pair, 0.08))
        except UntrustedError as error:
            refused.append(str(error))
    # Where the two solutions meet there is one broad summit, whose width is the reason.
    reasons = ("ambiguous", "at most ± 5 %", "too differently for a scale factor")
    assert all(any(reason in text for reason in reasons) for text in refused)
    # About a half of them, ± 14 % of 12 draws.
    assert 5 / 24 < len(results) / draws < 19 / 24
    for z in deviations(results):
        assert np.sqrt(np.mean(z**2)) < 1.6
        assert np.max(np.abs(z)) < 4.0


def test_fewer_than_twenty_usable_frames_are_refused_with_their_number():
    pair = observed(broadband(6), 6)
    rows = pair.rows.copy()
    rows[19:, 2] = np.inf
    text = refusal(replace(pair, rows=rows))
    assert "Only 19 usable frames" in text
    assert "20" in text


def test_a_wrong_unit_of_the_acceleration_is_met_as_a_wrong_scale_not_as_an_error():
    # The scale factor absorbs it (g taken for m/s²): only the user's knowledge of the scale can tell.
    pair = observed(broadband(7), 7)
    samples = pair.samples * [1.0, 1 / 9.80665, 1.0]
    found = calibrate_scale(replace(pair, samples=samples), 0.5)
    assert found.scale.value_m_per_px == pytest.approx(SCALE / 9.80665, rel=0.005)


def test_a_barely_known_scale_brings_a_warning_with_its_figure():
    found = calibrate_scale(observed(broadband(8), 8, noise_px=0.4), 0.15)
    relative = np.sqrt(found.scale.variance) / abs(found.scale.value_m_per_px)
    assert 0.01 < relative < 0.05
    (line,) = uncertain_scale("camera", relative, {"motion": relative, "compression": 0.5 * relative})
    assert line.code == "scale-uncertain"
    assert f"is uncertain by ± {100 * relative:.1f} %" in line
    assert "comes from too little motion for the noise. Choose" in line
    (line,) = uncertain_scale("camera", 0.015, {"motion": 0.001, "compression": 0.0149})
    assert "the largest part, ± 1.5 %, comes from video compression" in line
    assert uncertain_scale("camera", 0.0099, {"motion": 0.0099}) == []


def test_missing_frames_and_jittered_stamps_do_no_harm():
    pair = observed(broadband(9), 9)
    rng = np.random.default_rng(9)
    kept = rng.random(len(pair.rows)) > 0.3
    found = calibrate_scale(replace(pair, rows=pair.rows[kept]), 0.5)
    z = deviations([found])
    assert max(abs(z[0][0]), abs(z[1][0])) < 3.5


def test_lost_frames_in_the_window_are_found_and_taken_out():
    # Frames counted from a rate: after three lost ones every stamp is 0.3 s early.
    pair = observed(broadband(5), 5)
    stamps = pair.rows[:, 0].copy()
    rows = np.delete(pair.rows, [300, 301, 302], axis=0)
    rows[:, 0] = stamps[: len(rows)]
    found = calibrate_scale(replace(pair, rows=rows), 0.15)
    assert abs(found.scale.value_m_per_px - SCALE) < 4.0 * np.sqrt(found.scale.variance)
    assert np.sqrt(found.scale.variance) < 0.002 * SCALE
    assert abs(found.search.offset.value_s - OFFSET) < 2e-3
    assert "jumps in the calibration window: the calibration adds +300 ms" in found.warnings[0]


@pytest.mark.parametrize("seed", [5, *slow(6)])
def test_two_places_with_lost_frames_are_found_and_taken_out(seed):
    pair = observed(broadband(seed), seed)
    rows = np.delete(pair.rows, [190, 191, 192, 400, 401], axis=0)
    rows[:, 0] = pair.rows[: len(rows), 0]
    found = calibrate_scale(replace(pair, rows=rows), 0.15)
    assert abs(found.scale.value_m_per_px - SCALE) < 4.0 * np.sqrt(found.scale.variance)
    assert np.sqrt(found.scale.variance) < 0.002 * SCALE
    assert abs(found.search.offset.value_s - OFFSET) < 2e-3
    assert [re.search(r"adds ([+]\d+) ms", text)[1] for text in found.warnings[:2]] == ["+300", "+200"]


@pytest.mark.parametrize("step_m", [1.0, 1e-2])
def test_readings_that_hardly_leave_one_step_end_no_search_of_the_offset(step_m):
    # A ratio of nothing was divided by. The motion is of 3 mm rms: all readings are 0, or nearly all.
    pair = observed(broadband(0), 0, scale=1.0)
    rows = pair.rows.copy()
    rows[:, 1] = step_m * np.round(rows[:, 1] / step_m)
    assert np.isfinite(search_offset(Pair(pair.samples, rows), 0.2).fit.ratio)
