"""The guard: today's bridging of whole records made causal, the same for every cutting, and cover for every fault."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from midspan.engine.axis import AxisFigures, displacement_std, usual_figures
from midspan.engine.guard import Guard, GuardSettings
from midspan.engine.merge import Merge
from midspan.errors import UsageError
from midspan.records import NANOSECONDS, Arrival, Event, Readings, SampleKind, Samples, TimeSeries, joined
from midspan.signals.acceleration import prepare_acceleration
from midspan.signals.health import runs
from midspan.simulate.motion.motion import random_motion

NOISE_A, STEP_NS, NAME = 2e-3, 10_000_000, "accelerometer (accel.csv)"
TIME_NS = np.arange(6000, dtype=np.int64) * STEP_NS
DENSITY = NOISE_A**2 / 100.0


def channel(seed=0):
    """A minute of motion near 3 Hz at 100 Hz, with bias and noise."""
    motion = random_motion((0.5, 6.0), 2e-3, rng=np.random.default_rng(seed), flat="velocity")
    noise = np.random.default_rng(1000 + seed).normal(0, NOISE_A, len(TIME_NS))
    return motion.acceleration(TIME_NS / 1e9) + 0.03 + noise


class Merged:
    """A guard behind a merge, which leaves out what is out of order."""

    def __init__(self, guard, merge=None):
        self.guard, self.merge = guard, merge or Merge((NAME,))

    def push(self, readings):
        due = self.merge.push(Arrival(NAME, 0, readings))
        return [item for one in due for item in self.guard.push(one.record)]

    def finish(self):
        rest = [item for one in self.merge.finish() for item in self.guard.push(one.record)]
        return rest + self.guard.finish()


def run(guard, time_ns, value, cuts=()):
    """All samples as one block, and the events in the order of time."""
    values, guard = value.reshape(len(time_ns), -1), Merged(guard)
    out = []
    for piece in np.split(np.arange(len(time_ns)), cuts):
        out += guard.push(Readings(time_ns[piece], values[piece]))
    out += guard.finish()
    blocks = [item for item in out if isinstance(item, Samples)]
    events = sorted((item for item in out if isinstance(item, Event)), key=lambda event: (event.time_ns, event.text))
    return joined(blocks), events


def guard_of(*values, hold_s=1.0):
    """A guard that knows the usual figures of these channels (n,)."""
    figures = [replace(usual_figures(value, 100.0), name=NAME, noise_density=DENSITY) for value in values]
    return Guard(GuardSettings(100.0, tuple(figures), hold_s))


def whole(value, time_ns=TIME_NS):
    """What the whole-record preparation makes of a channel."""
    prepared = prepare_acceleration(TimeSeries(time_ns, value), NAME)
    return prepared, prepared.with_noise(DENSITY)


def test_sound_data_pass_exactly_as_they_are():
    value = channel()
    samples, events = run(guard_of(value), TIME_NS, value, cuts=range(7, 6000, 7))
    _, expected = whole(value)
    np.testing.assert_array_equal(samples.time_ns, expected.time_ns)
    np.testing.assert_array_equal(samples.value_m_s2[:, 0], expected.value_m_s2)
    np.testing.assert_array_equal(samples.noise_density[:, 0], expected.noise_density)
    assert not samples.kind.any()
    assert events == []


def test_sound_data_are_given_out_at_once():
    value = channel()
    guard = guard_of(value)
    behind = []
    for k in range(1000):
        guard.push(Readings(TIME_NS[k : k + 1], value[k : k + 1, None]))
        behind.append(len(guard.state.stamps.time_ns))
    # The largest sample ever seen waits for the next one, which may be equal.
    assert np.count_nonzero(behind) <= 2
    assert max(behind) <= 1


def spoilt(kind, value):
    """A channel with one kind of fault: time, value, samples from where on whole-record figures hold for it."""
    value, time_ns = value.copy(), TIME_NS
    if kind == "nan":
        for start, stop in ((500, 501), (1000, 1007), (3000, 3040), (4000, 4300)):
            value[start:stop] = np.nan
    elif kind == "ends":
        value[:30] = np.nan
        value[-25:] = np.nan
    elif kind == "gap":
        kept = np.r_[0:3000, 3300:4000, 4004:6000]
        value, time_ns = value[kept], TIME_NS[kept]
    elif kind == "clipped":
        value = np.clip(value, None, np.quantile(value, 0.985))
    elif kind == "both":
        kept = np.r_[0:3000, 3020:6000]
        value, time_ns = value[kept], TIME_NS[kept]
        value[2990:3005] = np.nan
    return time_ns, value


@pytest.mark.parametrize("kind", ["nan", "ends", "gap", "clipped", "both"])
@pytest.mark.parametrize("seed", range(3))
def test_holes_are_bridged_as_in_a_whole_record(kind, seed):
    time_ns, value = spoilt(kind, channel(seed))
    found, events = run(guard_of(value, hold_s=10.0), time_ns, value, cuts=range(13, len(value), 13))
    prepared, expected = whole(value, time_ns)
    np.testing.assert_array_equal(found.time_ns, expected.time_ns)
    # The mean of a wholly unknown hole is drawn to in one step here: equal to rounding.
    np.testing.assert_allclose(found.value_m_s2[:, 0], expected.value_m_s2, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.noise_density[:, 0], expected.noise_density, rtol=1e-12)
    measured = found.kind != SampleKind.INSERTED
    np.testing.assert_array_equal(found.kind[measured] == SampleKind.BRIDGED, prepared.missing)
    # A hole of which nothing is known is reported when it is found, too.
    ends = [(event.time_ns, event.text) for event in events if not event.text.endswith("from here on.")]
    assert sorted(ends) == sorted((event.time_ns, event.text) for event in prepared.events)


@pytest.mark.parametrize("length", [20, 100, 400])
def test_a_frozen_channel_is_bridged_from_its_first_repeated_sample(length):
    value = channel()
    value[3000 : 3000 + length] = value[3000]
    guard, out, waits = guard_of(channel()), [], []
    for k in range(6000):
        out += guard.push(Readings(TIME_NS[k : k + 1], value[k : k + 1, None]))
        waits.append(len(guard.state.stamps.time_ns))
        # Live, somebody has to know within some seconds.
        assert not guard.unseen or 3000 < k <= 3000 + length
        assert guard.unseen == "frozen" or not 3300 < k < 3000 + length
    out += guard.finish()
    found = joined([item for item in out if isinstance(item, Samples)])
    np.testing.assert_array_equal(np.flatnonzero(found.kind), np.arange(3001, 3000 + length))
    texts = [item.text for item in out if isinstance(item, Event) and item.text.endswith("bridged.")]
    assert texts == [f"{NAME}: {length - 1} samples bridged."]
    # It waits no longer than a hole does, until nothing is known of the motion, whose period is a third of a second.
    assert max(waits) < 20
    prepared, expected = whole(value)
    np.testing.assert_array_equal(np.flatnonzero(prepared.missing), np.arange(3001, 3000 + length))
    assert f"{length - 1} samples" in prepared.warnings[0]
    np.testing.assert_array_equal(found.value_m_s2[3000 + length :, 0], expected.value_m_s2[3000 + length :])


# Noise and motion in steps of the resolution: rest, hardly any motion, motion of a few steps, motion of many.
@pytest.mark.parametrize(("noise", "moved"), [(0.2, 0.0), (0.5, 0.0), (0.3, 0.3), (0.2, 3.0), (0.2, 30.0)])
def test_equal_values_of_a_coarse_sensor_are_not_frozen(noise, moved):
    fine, rng = channel() - 0.03, np.random.default_rng(7)
    steps = moved * fine / np.std(fine) + noise * rng.standard_normal(len(fine)) + 0.13
    value = 9.81e-3 * np.round(steps)
    found, events = run(guard_of(value), TIME_NS, value, cuts=range(50, 6000, 50))
    assert not found.kind.any()
    assert events == []
    assert not whole(value)[0].missing.any()


def test_rest_at_the_mean_is_not_frozen():
    value = channel()
    rest = np.where(np.arange(6000) < 3000, value, np.mean(value))
    # The motion fades out gently before it rests.
    rest[2900:3000] = np.mean(value) + (rest[2900:3000] - np.mean(value)) * np.linspace(1, 0, 100) ** 4
    found, events = run(guard_of(value), TIME_NS, rest, cuts=range(11, 6000, 11))
    assert not found.kind.any()
    assert events == []


@pytest.mark.parametrize("hold_s", [0.05, 1.0])
def test_nothing_waits_longer_than_it_may(hold_s):
    value = channel()
    value[1000:5000] = np.nan
    guard = guard_of(channel(), hold_s=hold_s)
    waits, out = [], []
    for k in range(6000):
        out += guard.push(Readings(TIME_NS[k : k + 1], value[k : k + 1, None]))
        waits.append(len(guard.state.stamps.time_ns))
    assert max(waits) < round(100 * hold_s)
    # At the last sample but one of the hole everything is given out.
    assert waits[4998] == 0
    samples = joined([item for item in out if isinstance(item, Samples)])
    figures = guard.settings.axes[0]
    np.testing.assert_array_equal(samples.value_m_s2[1000:5000, 0], figures.mean_m_s2)
    np.testing.assert_array_equal(samples.noise_density[1000:5001, 0], DENSITY + figures.unknown_density)


FAULTS = st.lists(
    st.tuples(
        st.sampled_from(["nan", "inf", "held", "gap", "back", "doubled", "top", "huge", "spike"]), st.integers(0, 399)
    ),
    max_size=8,
)


def faulty(faults, seed):
    """Two channels of 400 samples at 100 Hz with faults at the given samples."""
    rng = np.random.default_rng(seed)
    value, steps = rng.normal(0.0, 1.0, (400, 2)), np.full(400, STEP_NS)
    for number, (kind, at) in enumerate(faults):
        axis, stop = number % 2, at + int(rng.integers(1, 160))
        if kind in ("nan", "inf", "huge"):
            value[at:stop, axis] = {"nan": np.nan, "inf": -np.inf, "huge": 1e300}[kind]
        elif kind == "held":
            value[at:stop, axis] = value[at, axis]
        elif kind == "spike":
            value[at : at + stop % 4, axis] = 1e3
        elif kind == "top":
            value[at : at + 5, axis] = 4.0
        else:
            steps[at] += {"gap": 1, "back": -1, "doubled": 0}[kind] * int(rng.integers(3, 40)) * STEP_NS // 7
            steps[at] = 0 if kind == "doubled" else steps[at]
    return np.cumsum(steps), value


@given(FAULTS, st.integers(0, 99), st.lists(st.integers(0, 400), max_size=6))
@settings(max_examples=30, deadline=None)
def test_any_cutting_and_any_restart_give_the_same_samples(faults, seed, cuts):
    time_ns, value = faulty(faults, seed)
    figures = AxisFigures(0.0, 1.0, 25.0, -3.0, 3.0, 1e-9, 4e-5, DENSITY, NAME)
    settings = GuardSettings(100.0, (figures, figures))
    samples, events = run(Guard(settings), time_ns, value)
    assert np.all(np.diff(samples.time_ns) > 0)
    assert np.isfinite(samples.value_m_s2).all()
    assert np.all(samples.noise_density >= DENSITY)
    by_parts, out = [], []
    guard = Merged(Guard(settings))
    for piece in np.split(np.arange(400), sorted(cuts)):
        out += guard.push(Readings(time_ns[piece], value[piece]))
        other = Guard(settings)
        other.restore(guard.guard.state)
        guard = Merged(other, guard.merge)
    by_parts.append(out + guard.finish())
    guard, out = Merged(Guard(settings)), []
    for k in range(400):
        out += guard.push(Readings(time_ns[k : k + 1], value[k : k + 1]))
    by_parts.append(out + guard.finish())
    for out in by_parts:
        again = joined([item for item in out if isinstance(item, Samples)])
        np.testing.assert_array_equal(again.time_ns, samples.time_ns)
        np.testing.assert_array_equal(again.value_m_s2, samples.value_m_s2)
        np.testing.assert_array_equal(again.noise_density, samples.noise_density)
        np.testing.assert_array_equal(again.kind, samples.kind)
        reported = sorted(
            (item for item in out if isinstance(item, Event)), key=lambda event: (event.time_ns, event.text)
        )
        assert reported == events


@pytest.mark.parametrize("cut", [6000, 10, 7, 1])
def test_a_clipped_crest_is_drawn_through_at_a_level_that_was_not_known(cut):
    # Three modes up to 4 Hz, whose crests are held at a level that the usual figures have often seen exceeded.
    at = TIME_NS / NANOSECONDS
    true = 0.05 + sum(a * np.sin(2 * np.pi * f * at + a) for a, f in ((0.3, 1.1), (0.4, 2.3), (0.3, 3.9)))
    true = true + np.random.default_rng(3).normal(0, 2e-3, len(at))
    level = np.quantile(true, 0.985)
    value = np.minimum(true, level)
    guard, out = Merged(guard_of(true)), []
    for k in range(0, len(value), cut):
        out += guard.push(Readings(TIME_NS[k : k + cut], value[k : k + cut, None]))
    found = joined([item for item in out + guard.finish() if isinstance(item, Samples)])
    np.testing.assert_array_equal(found.time_ns, TIME_NS)
    whole, _ = run(guard_of(true), TIME_NS, value)
    np.testing.assert_array_equal(found.value_m_s2, whole.value_m_s2)
    np.testing.assert_array_equal(found.noise_density, whole.noise_density)
    lost = true > level
    # A velocity is what is left: what each crest lacks in all. A straight line lacks all that was cut off.
    lacks = [np.sum(found.value_m_s2[a:b, 0] - true[a:b]) for a, b in runs(lost)]
    cut_off = [np.sum(true[a:b] - level) for a, b in runs(lost)]
    assert np.sqrt(np.mean(np.square(lacks))) < 0.25 * np.sqrt(np.mean(np.square(cut_off)))
    assert np.mean(found.kind[lost] == SampleKind.BRIDGED) > 0.6


def test_a_step_back_of_the_clock_is_an_event_and_the_motion_may_be_anywhere():
    value = channel()
    time_ns = TIME_NS.copy()
    time_ns[3000:] -= 303_000_000
    found, events = run(guard_of(channel()), time_ns, value, cuts=range(1, 6000))
    assert [event.kind for event in events] == ["backwards"]
    assert "0.293 s" in events[0].text
    assert len(found.time_ns) == 6000 - 30
    (raised,) = np.flatnonzero(found.noise_density[:, 0] > DENSITY)
    assert found.time_ns[raised] == TIME_NS[2999] + 7_000_000
    # Over 7 ms the density adds a variance of twice that of the motion.
    figures = replace(usual_figures(channel(), 100.0), name=NAME, noise_density=DENSITY)
    place = figures.moved_m**2
    assert found.noise_density[raised, 0] * 0.007**3 / 3.0 == pytest.approx(2.0 * place, rel=1e-3)


@pytest.mark.parametrize("kind", ["backwards", "clock"])
def test_after_a_step_of_the_clock_the_motion_may_be_anywhere(kind):
    value = channel()
    guard = guard_of(value)
    event = Event(0, kind, "accel: time runs backwards by 0.3 s.")
    out = guard.push(Readings(TIME_NS[:10], value[:10, None]))
    assert guard.push(event) == [event]
    (block,) = guard.push(Readings(TIME_NS[10:20], value[10:20, None]))
    assert len(out[0].time_ns) == 10
    np.testing.assert_array_equal(np.flatnonzero(block.noise_density[:, 0] > DENSITY), [0])


def test_wrong_shapes_are_refused():
    with pytest.raises(UsageError, match="shape"):
        guard_of(channel()).push(Readings(TIME_NS[:3], np.zeros((3, 2))))
    with pytest.raises(UsageError, match="axes"):
        guard_of(channel()).restore(guard_of(channel(), channel()).state)
    with pytest.raises(UsageError, match="rate_hz"):
        Guard(GuardSettings(0.0, ()))


def test_the_displacement_is_reported_by_its_acceleration():
    # Most of the acceleration is fast, and most of the displacement slow.
    time = np.arange(0.0, 60.0, 0.01)
    tones = ((4e-3, 0.5), (0.5e-3, 5.0))
    value = sum(-m * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time + f) for m, f in tones)
    noise = 2e-3 * np.random.default_rng(0).standard_normal(len(time))
    # Of sines the variance is half the amplitude squared; noise of this density adds 0.03 mm.
    true_m = np.sqrt(sum(0.5 * m * m for m, _ in tones))
    assert displacement_std(value + noise + 9.81, 100.0) == pytest.approx(true_m, rel=0.02)


def test_the_noise_goes_with_the_motion_and_any_cutting_gives_the_same():
    value = channel()
    figures = replace(usual_figures(value, 100.0), name=NAME, noise_density=DENSITY, motion_noise_s=1e-4)
    cut, _ = run(Guard(GuardSettings(100.0, (figures,))), TIME_NS, value, cuts=[5, 6, 100, 3333])
    uncut, _ = run(Guard(GuardSettings(100.0, (figures,))), TIME_NS, value)
    assert np.array_equal(cut.noise_density, uncut.noise_density)
    # Of a stationary motion on the average its variance, of which a minute shows all but a few per cent.
    assert np.mean(cut.noise_density) == pytest.approx(DENSITY + 1e-4 * figures.variance, rel=0.05)
    assert np.ptp(cut.noise_density) > DENSITY


def test_a_lone_spike_is_bridged_and_an_impact_is_not():
    value = channel()
    spoilt = value.copy()
    spoilt[1000], spoilt[3000:3002] = 500.0, -400.0
    # An impact of the same size that rings.
    ringing = np.arange(100)
    spoilt[4500:4600] += 450.0 * np.exp(-ringing / 10.0) * np.cos(2.0 * ringing)
    found, events = run(guard_of(value), TIME_NS, spoilt, cuts=range(1, 6000))
    assert np.flatnonzero(found.kind).tolist() == [1000, 3000, 3001]
    assert [event.kind for event in events] == ["bridged", "spike"] * 2
    at_once, same = run(guard_of(value), TIME_NS, spoilt)
    np.testing.assert_array_equal(at_once.value_m_s2, found.value_m_s2)
    np.testing.assert_array_equal(at_once.noise_density, found.noise_density)
    assert same == events
    prepared, _ = whole(spoilt)
    np.testing.assert_array_equal(np.flatnonzero(prepared.missing), [1000, 3000, 3001])
    assert "3 samples" in prepared.warnings[0]
    assert "are spikes far beyond all others" in prepared.warnings[0]


def test_a_doubtful_span_raises_the_noise_there_alone_for_every_cutting():
    value, span = channel(), (int(TIME_NS[1000]), int(TIME_NS[1500]), 1e-4)
    figures = replace(usual_figures(value, 100.0), name=NAME, noise_density=DENSITY)
    settings_ = GuardSettings(100.0, (figures,), doubtful=(span,))
    whole, _ = run(Guard(settings_), TIME_NS, value)
    cut, _ = run(Guard(settings_), TIME_NS, value, cuts=(1, 700, 1200, 1201))
    inside = (whole.time_ns >= span[0]) & (whole.time_ns <= span[1])
    expected = np.where(inside, DENSITY + 1e-4, DENSITY)
    assert np.allclose(whole.noise_density[:, 0], expected, rtol=1e-12)
    assert np.array_equal(cut.noise_density, whole.noise_density)
