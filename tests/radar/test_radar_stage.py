"""The radar's stage, frame by frame: exact cutting, noise, places, cycles, outages, and the loop with the estimator."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from radar_cases import RATE, SHORT, UNIT, accelerometer

from midspan.engine.radar import RadarChain
from midspan.engine.radar_target import FollowedTarget
from midspan.errors import UsageError
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings
from midspan.radar.following import Background
from midspan.radar.range_profile import bin_kernel
from midspan.radar.target import Target
from midspan.records import Channel, Measured, RangeFrame, SampleKind, Samples, Source, Status, nanoseconds
from midspan.simulate.motion.motion import Sines, random_motion
from midspan.simulate.radar.signal import LONG_RANGE, beat

AMPLITUDE, SNR_DB = 1000.0, 25.0
NS = 10_000_000


def target_at(place: float, receivers: int = 1, **known) -> Target:
    """A calibrated target met in its own bin; `snr_db` of the receivers together."""
    values = {"place_bin": place, "range_m": place * SHORT.bin_m, "amplitude": AMPLITUDE, "snr_db": SNR_DB}
    values |= {"weights": np.ones(receivers, dtype=complex) / np.sqrt(receivers), "disagreement_rad": 0.0}
    # With a background the amplitude is that at the peak.
    values |= {"conversion_factor": 1.0, "background": Background(np.arange(2.0), np.zeros(2, dtype=complex))}
    return Target(**(values | known))


def followed(target: Target, chirp=SHORT) -> FollowedTarget:
    return FollowedTarget.of(target, chirp.phase_per_m(target.range_m), chirp.bin_m, period_s=0.01, bins=chirp.bins)


def profiles(chain: RadarChain, moved, *, place=20.3, receivers=1, seed=0, chirp=SHORT, snr_db=SNR_DB, companions=0.0):
    """Phasors (n, receivers, bins) of a target that is `moved` (n,) m from its place, and of another that stays."""
    rng = np.random.default_rng(seed)
    kernel = bin_kernel(chain.bins, chirp).T
    echo = beat(place * chirp.bin_m + np.asarray(moved), chirp)
    echo = AMPLITUDE * (echo + companions * beat(np.array([(place + 0.4) * chirp.bin_m]), chirp))
    # Hann: 1.5 / samples of a sample's noise is left; receivers together have the square root of that.
    std = AMPLITUDE * 10 ** (-snr_db / 20) * np.sqrt(receivers * chirp.samples / 1.5 / 2)
    out = np.empty((len(echo), receivers, kernel.shape[1]), dtype=np.complex64)
    for k in range(receivers):
        noise = rng.normal(0, std, (*echo.shape, 2))
        out[:, k] = (echo + noise[..., 0] + 1j * noise[..., 1]) @ kernel
    return out


def frames_of(phasors, valid=None):
    valid = np.ones(phasors.shape[:2], dtype=bool) if valid is None else valid
    return [RangeFrame(k * NS, one, some) for k, (one, some) in enumerate(zip(phasors, valid, strict=True))]


def driven(chain: RadarChain, frames, moved=None, *, std_cycles=0.05, off_cycles=0.0):
    """Measurements of the first target; predicted by the truth since the first frame, to a deviation.

    A prediction is off by `off_cycles` (n,), and from then on by what the phase was off, as an estimator's would be.
    """
    found, begun, count = [], False, 0.0
    unit = chain.targets[0].phase_per_m
    spread, off = (np.broadcast_to(np.asarray(x, dtype=float), len(frames)) for x in (std_cycles, off_cycles))
    for k, frame in enumerate(frames):
        given = None
        if begun:
            given = (unit * (moved[k] - moved[0]) + 2 * np.pi * (count + off[k]), (2 * np.pi * spread[k]) ** 2)
        (one,) = chain.push(frame, [given])
        if one.status == Status.TRACKING and moved is not None:
            begun = True
            count = np.rint((one.phase_rad - unit * (moved[k] - moved[0])) / (2 * np.pi))
        found.append(one)
    return found


def errors(found, moved, unit):
    """Error of the phase (n,) in rad since the first frame, NaN where not used."""
    return np.array([one.phase_rad for one in found]) - unit * (moved - moved[0])


# Two bins weighed (1 − s, s) hold the noise 1 − 2 s (1 − s) / 3 and (1 − s) w(s) + s w(1 − s) of the target, with the
# window's response w = sin πs / (πs (1 − s²)): at s = 0.3, 0.86 / 0.877²; at ½, 5/6 / 0.849².
@pytest.mark.parametrize(("place", "loss"), [(20.0, 1.0), (20.3, 1.119), (20.5, 1.156)])
def test_the_stated_variance_is_that_of_the_phase_wherever_the_target_lies_between_bins(place, loss) -> None:
    chain = RadarChain([followed(target_at(place))])
    moved = np.zeros(3000)
    found = driven(chain, frames_of(profiles(chain, moved, place=place)), moved)
    phase = np.array([one.phase_rad for one in found])
    known = np.isfinite(phase)
    stated = np.mean([one.variance_rad2 for one, good in zip(found, known, strict=True) if good])
    # 3000 draws know a variance to 2.6 %; the amplitude's own noise adds 0.3 %.
    assert np.var(phase[known]) == pytest.approx(stated, rel=0.09)
    # The amplitude's own noise makes the mean of its inverse square larger by 0.6 %.
    assert stated == pytest.approx(0.5 * 10 ** (-SNR_DB / 10) * loss, rel=0.015)
    assert np.mean([one.strength for one in found]) == pytest.approx(1.0, abs=0.01)
    assert all(one.reference_variance_rad2 < 1e-12 for one in found)


def test_any_cutting_and_a_state_that_is_restored_give_the_same_bits() -> None:
    moved = random_motion((0.5, 4.0), 2e-3, rng=np.random.default_rng(1)).displacement(np.arange(1500) / RATE)
    items = [followed(target_at(20.3, 2)), followed(target_at(23.1, 2, range_m=1.25))]
    whole = RadarChain(items)
    phasors, valid = profiles(whole, moved, receivers=2), np.ones((1500, 2), dtype=bool)
    phasors[600:800] *= 0.01
    valid[900:1000, 0], valid[950] = False, False
    frames = frames_of(phasors, valid)
    given = [[(UNIT * float(m), 0.1), None] for m in moved]
    expected = [whole.push(frame, reported) for frame, reported in zip(frames, given, strict=True)]
    chain, got = RadarChain(items), []
    for k, (frame, reported) in enumerate(zip(frames, given, strict=True)):
        if k in (1, 5, 30, 700, 812, 951, 1200):
            state = pickle.loads(pickle.dumps(chain.state))
            # What is pushed afterwards does not change a state that was taken.
            chain.push(frame, reported)
            chain = RadarChain(items)
            chain.restore(state)
        got.append(chain.push(frame, reported))
    assert repr(got) == repr(expected)
    assert {one.status for pair in got for one in pair} == set(Status)


def test_a_motion_through_several_bins_is_followed_at_full_strength() -> None:
    chain = RadarChain([followed(target_at(20.3, reach_bins=1.8))])
    moved = 0.1 * np.sin(2 * np.pi * 0.5 * np.arange(2000) / RATE)
    found = driven(chain, frames_of(profiles(chain, moved)), moved)
    error = errors(found, moved, UNIT_AT)
    assert np.isfinite(error[20:]).all()
    strength = np.array([one.strength for one in found[100:]])
    # The place is known to some hundredths of a bin, the noise of an amplitude is 4 %.
    assert np.mean(strength) == pytest.approx(1.0, abs=0.01)
    stated = np.array([one.variance_rad2 for one in found])[20:]
    assert np.mean((error[20:] - error[20:].mean()) ** 2 / stated) == pytest.approx(1.0, abs=0.15)


UNIT_AT = SHORT.phase_per_m(20.3 * SHORT.bin_m)


def test_a_weak_target_s_zero_is_its_first_frame_though_frames_after_it_are_faint() -> None:
    # 9 dB: of the first frames, by which the speed is found, many records have one below 0.4 of the usual amplitude.
    moved = Sines(np.array([5e-3]), np.array([1.0])).displacement(np.arange(120) / RATE)
    left = []
    for seed in range(30):
        chain = RadarChain([followed(target_at(20.0, snr_db=9.0))])
        error = errors(
            driven(chain, frames_of(profiles(chain, moved, place=20.0, snr_db=9.0, seed=seed))), moved, UNIT_AT
        )
        left.append(np.nanmean(error[-40:]))
    # In 0.1 s the structure moves by 10 rad; the phase's noise is 0.25 rad, and that of the first frame is left.
    assert np.max(np.abs(left)) < 4.0 * 0.25


@pytest.mark.parametrize("seed", range(4))
def test_without_predictions_it_begins_in_full_swing_and_follows_three_times_the_speed_of_plain_unwrapping(
    seed,
) -> None:
    chain = RadarChain([followed(target_at(20.3, reach_bins=0.7))])
    rng = np.random.default_rng(seed)
    moved = Sines(np.array([0.3 / (2 * np.pi * 1.1)]), np.array([1.1]), phase_rad=rng.uniform(0, 6.3)).displacement(
        np.arange(1500) / RATE
    )
    found = driven(chain, frames_of(profiles(chain, moved, seed=seed)))
    error = errors(found, moved, UNIT_AT)
    assert np.isfinite(error[64:]).all()
    assert np.nanmax(np.abs(error)) < 1.0
    # Its own prediction lags by up to a radian, and says that a cycle might be lost.
    assert found[-1].reference_variance_rad2 < np.pi**2


def outage(*, chirp=SHORT, companions=0.0):
    """Hidden from 10 to 12 s; the first prediction after it is 3.2 cycles off and says that it may be 2."""
    target = target_at(20.3, range_m=20.3 * chirp.bin_m)
    chain = RadarChain([followed(target, chirp)], "near")
    moved = random_motion((0.5, 4.0), 2e-3, rng=np.random.default_rng(1)).displacement(np.arange(2600) / RATE)
    phasors = profiles(chain, moved, chirp=chirp, companions=companions)
    phasors[1000:1200] *= 0.01
    # Five good frames must pass before the target counts as back.
    std, off = np.full(2600, 0.05), np.zeros(2600)
    std[1000:1205], off[1204] = np.linspace(0.05, 2.0, 205), 3.2
    found = driven(chain, frames_of(phasors), moved, std_cycles=std, off_cycles=off)
    return found, errors(found, moved, chirp.phase_per_m(target.range_m))


def test_an_outage_leaves_a_new_zero_until_the_range_tells_the_cycle() -> None:
    found, error = outage()
    hidden = found[1000:1204]
    assert all(np.isnan(one.phase_rad) and np.isinf(one.variance_rad2) for one in hidden)
    status = [one.status for one in hidden]
    assert (status[0], status[-1]) == (Status.COASTING, Status.LOST)
    back = found[1204]
    # The variance of the zero is a hundred times that of the prediction: 2 cycles.
    assert back.reference_variance_rad2 == pytest.approx(100 * (4 * np.pi) ** 2)
    assert error[1204] == pytest.approx(6 * np.pi, abs=0.3)
    assert np.nanmax(np.abs(error[:1000])) < 0.3
    assert np.nanmax(np.abs(error[-1000:])) < 0.3
    # What is left is the chance of a slip among the first frames.
    assert found[-1].reference_variance_rad2 < 1e-12
    kinds = [event.kind for one in found for event in one.events]
    assert kinds == ["blocked", "seen", "new datum", "cycle"]
    texts = [event.text for one in found for event in one.events]
    assert all(text.startswith("near: the target") for text in texts)
    assert "corrects the cycle by -3" in texts[-1]


@pytest.mark.parametrize(("chirp", "companions"), [(SHORT, 0.3), (LONG_RANGE, 0.15)])
def test_where_the_range_cannot_tell_the_zero_stays_a_new_one(chirp, companions) -> None:
    found, error = outage(chirp=chirp, companions=companions)
    right = abs(np.nanmedian(error[-500:]) - np.nanmedian(error[:1000])) < np.pi
    # What is left is the chance of a slip among the first frames.
    assert right == (found[-1].reference_variance_rad2 < 1e-12)
    kinds = [event.kind for one in found for event in one.events]
    assert "new datum" in kinds


def test_a_receiver_with_a_hole_leaves_the_others_and_their_noise() -> None:
    chain = RadarChain([followed(target_at(20.3, 4))])
    moved, valid = np.zeros(400), np.ones((400, 4), dtype=bool)
    valid[200:, 1] = False
    phasors = profiles(chain, moved, receivers=4)
    phasors[~valid] = np.nan
    found = driven(chain, frames_of(phasors, valid), moved)
    before, after = ([one.variance_rad2 for one in found[part]] for part in (slice(50, 200), slice(200, 400)))
    # Three of four receivers; medians of amplitudes that scatter by 4 %.
    assert np.median(after) / np.median(before) == pytest.approx(4 / 3, rel=0.03)
    assert np.isfinite(errors(found, moved, UNIT_AT)[200:]).all()
    assert all(one.status == Status.TRACKING for one in found[200:])


def test_predictions_that_the_phase_refutes_are_not_followed() -> None:
    chain = RadarChain([followed(target_at(20.3, reach_bins=0.6))])
    time = np.arange(1500) / RATE
    moved = Sines(np.array([0.03]), np.array([1.0])).displacement(time)
    # From 5 s on they are those of another event, and sure of themselves.
    other = np.where(time < 5, 0.0, UNIT_AT * 0.03 * np.sin(2 * np.pi * 1.7 * (time - 5))) / (2 * np.pi)
    found = driven(chain, frames_of(profiles(chain, moved)), moved, off_cycles=other)
    error = errors(found, moved, UNIT_AT)
    late = error[700:] - np.median(error[700:])
    assert np.max(np.abs(late)) < 1.0


def test_a_stored_target_without_bins_is_followed_in_its_own_column() -> None:
    item = FollowedTarget.of(target_at(3.0, background=None), UNIT, np.nan, period_s=0.01, bins=4)
    chain = RadarChain([item])
    np.testing.assert_array_equal(chain.bins, [3.0])
    moved = 1e-3 * np.sin(2 * np.pi * np.arange(500) / RATE)
    z = (AMPLITUDE * np.exp(1j * UNIT * moved)).astype(np.complex64)[:, None, None]
    found = driven(chain, frames_of(z))
    error = errors(found, moved, UNIT)
    assert np.nanmax(np.abs(error)) < 1e-5
    with pytest.raises(UsageError, match="1 bins"):
        chain.push(RangeFrame(0, np.zeros((1, 2), dtype=np.complex64), np.ones(1, dtype=bool)))


def loop(items, phasors, samples, noise):
    """Rows (s,) of chain and estimator in turn: time in s, displacement and its deviation in m."""
    chain = RadarChain(items)
    channels = tuple(
        Channel("radar", Source.RADAR, item.phase_per_m, str(k), zero_std_m=0.1 if k else 1e-5)
        for k, item in enumerate(items)
    )
    estimator = Estimator(EstimatorSettings(channels, bias_m_s2=(0.03,)))
    rows, times, f = [], nanoseconds(samples[:, 0]), 0
    frames = frames_of(phasors)
    for k, time_ns in enumerate(times):
        while f < len(frames) and frames[f].time_ns <= time_ns:
            given = [estimator.predict(c, frames[f].time_ns) for c in range(len(items))]
            met = chain.push(frames[f], given)
            columns = ("phase_rad", "variance_rad2", "reference_variance_rad2")
            values = [np.array([getattr(one, name) for one in met]) for name in columns]
            estimator.push(Measured(np.full(len(met), frames[f].time_ns), np.arange(len(met)), *values))
            f += 1
        kind = np.array([SampleKind.MEASURED], dtype=np.uint8)
        sample = Samples(times[k : k + 1], samples[k : k + 1, 1:], np.full((1, 1), noise**2 / RATE), kind)
        rows += [estimate for out in estimator.push(sample) for estimate in out.estimates]
    joined = (
        np.concatenate([getattr(row, name) for row in rows]) for name in ("time_ns", "displacement_m", "variance_m2")
    )
    stamps, value, variance = joined
    return stamps / 1e9, value, np.sqrt(variance)


def test_with_the_estimator_a_target_that_drives_off_is_left_out_and_fast_motion_is_followed() -> None:
    noise, time = 3e-3, np.arange(1500) / RATE
    motion = Sines(np.array([0.03, 0.002]), np.array([1.0, 2.7]), phase_rad=0.7)  # 0.19 m/s: two cycles a frame
    first, second = target_at(20.3, reach_bins=0.6), target_at(30.4, reach_bins=0.6, range_m=30.4 * SHORT.bin_m)
    items = [followed(first), followed(second)]
    chain = RadarChain(items)
    moved = motion.displacement(time)
    leaving = np.clip(time - 8.0, 0.0, 2.0) * 0.02
    phasors = profiles(chain, moved, seed=1) + profiles(chain, moved + leaving, place=30.4, seed=2)
    stamps, value, std = loop(items, phasors, accelerometer(motion, 15.0, noise=noise), noise)
    found = [one.status for one in RadarChain(items).push(frames_of(phasors)[0])]
    assert found == [Status.LOST, Status.LOST]  # the first frames tell the speed
    error = value - motion.displacement(stamps)
    later = (stamps > 3.0) & (stamps < 14.5)
    error = error[later] - np.median(error[later])
    # A frame is known to 12 µm; a cycle would be 1.9 mm, the leaving target 40 mm.
    assert np.sqrt(np.mean(error**2)) < 12e-6
    assert np.mean(np.abs(error) < 1.96 * std[later]) > 0.9


def test_a_still_part_of_the_bin_is_taken_out_as_it_was_calibrated() -> None:
    moved = 2e-3 * np.sin(2 * np.pi * np.arange(800) / RATE)
    plain = RadarChain([followed(target_at(20.3))])
    kernel = bin_kernel(plain.bins, SHORT).T
    still = 0.2 * AMPLITUDE * (beat(np.array([20.6 * SHORT.bin_m]), SHORT)[0] @ kernel)
    phasors = profiles(plain, moved) + still.astype(np.complex64)
    clean = RadarChain([followed(target_at(20.3, background=Background(plain.bins, still)))])
    spread = [np.nanstd(errors(driven(chain, frames_of(phasors), moved), moved, UNIT_AT)) for chain in (plain, clean)]
    # What lies 0.3 bins away bends by 0.2 rad of its share in phase; the noise is 0.04 rad.
    assert spread[0] > 0.1
    assert spread[1] < 0.05


def test_clutter_and_an_oscillators_noise_are_in_the_variance() -> None:
    chain = RadarChain([followed(replace(target_at(20.3), modulation_rad=0.1, phase_noise_rad2=0.01))])
    found = driven(chain, frames_of(profiles(chain, np.zeros(40))))
    assert found[-1].variance_rad2 == pytest.approx(0.02 + 0.5 * 10 ** (-SNR_DB / 10), rel=0.02)
