"""A sensor of displacement value by value: stuck values are found as in a whole record, and nothing else."""

import itertools

import numpy as np
import pytest

from midspan.engine.merge import Merge
from midspan.engine.plain import PlainChain, PlainSettings
from midspan.errors import UsageError
from midspan.records import Arrival, Event, Measured, Readings, Samples, joined, part
from midspan.signals.clipping import resolution
from midspan.signals.stuck import stuck
from midspan.simulate.motion.motion import Sines, Window, random_motion

NOISE = 2e-3


def samples_of(motion, seed, length_s=60.0):
    """Samples at 100 Hz with 2 mm/s² of noise and a bias of 20 mm/s²."""
    time = np.arange(0.0, length_s, 0.01)
    value = motion.acceleration(time) + 0.02 + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    zeros = np.zeros(len(time), dtype=np.uint8)
    return Samples(stamps(time), value[:, None], np.full((len(time), 1), NOISE**2 / 100.0), zeros)


def stamps(time_s):
    return np.rint(time_s * 1e9).astype(np.int64)


def run(chain, samples, time_s, value, cuts=(), seed=0):
    """All that the chain gives for both; cuts: numbers of samples that each push reaches to (none: one push), values
    come in blocks of any size before the samples that reach them.
    """
    time_ns, out, done, rng = stamps(time_s), [], 0, np.random.default_rng(seed)
    for start, stop in itertools.pairwise([0, *cuts, len(samples.time_ns)]):
        due = (
            max(int(np.searchsorted(time_ns, samples.time_ns[stop - 1], side="right")), done) if stop > start else done
        )
        # Some come early.
        due = min(due + int(rng.integers(0, 20)), len(time_ns))
        while done < due:
            until = min(done + int(rng.integers(1, 30)), due)
            out += chain.push(Readings(time_ns[done:until], value[done:until, None]))
            done = until
        chain, other = PlainChain(chain.settings), chain
        chain.state = other.state
        out += chain.push(part(samples, slice(start, stop)))
    return out


def used(out, time_s):
    """Which of the values (n,) became measurements."""
    return np.isin(stamps(time_s), joined([item for item in out if isinstance(item, Measured)]).time_ns)


def settings(value, step_s, **more):
    return PlainSettings("displacement", 3, 1e-8, step_s, resolution_m=resolution(value), **more)


@pytest.mark.parametrize(("rate_hz", "count"), [(1.0, 12), (10.0, 40), (100.0, 300)])
@pytest.mark.parametrize("late_s", [0.0, 0.0037], ids=["stamps of samples", "stamps between samples"])
@pytest.mark.parametrize("seed", range(4))
def test_a_stuck_value_is_left_out_until_it_changes(rate_hz, count, late_s, seed):
    motion = random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(seed), flat="velocity")
    time = np.arange(0.5, 59.5, 1.0 / rate_hz) + late_s
    value = motion.displacement(time) + 1e-4 * np.random.default_rng(seed).standard_normal(len(time))
    first = len(time) // 3
    value[first : first + count] = value[first]
    out = run(PlainChain(settings(value, 1.0 / rate_hz)), samples_of(motion, seed), time, value)
    left_out = np.flatnonzero(~used(out, time))
    # From where the acceleration tells it: after five values and a second at the latest, up to the last of them.
    assert left_out[0] <= first + max(6, rate_hz)
    np.testing.assert_array_equal(left_out, np.arange(left_out[0], first + count))
    begun, ended = [item for item in out if isinstance(item, Event)]
    assert "while the structure moved; it is left out until it changes." in begun.text
    assert begun.time_ns == stamps(time)[left_out[0]]
    assert f"{count} values were frozen at {1e3 * value[first]:.6g} mm" in ended.text
    assert f"{len(left_out)} were left out" in ended.text


@pytest.mark.parametrize("step_m", [1e-5, 1e-4, 1e-3])
def test_coarse_resolution_at_rest_is_no_fault(step_m):
    shaking = Window(Sines(np.array([5e-3]), np.array([1.3])), 28.0, 32.0, ramp_s=1.0)
    time = np.arange(0.5, 59.5, 0.1)
    value = np.round((shaking.displacement(time) + 0.0123) / step_m) * step_m
    for seed in range(3):
        samples = samples_of(shaking, seed)
        rows = np.column_stack((samples.time_ns / 1e9, samples.value_m_s2[:, 0], samples.noise_density[:, 0]))
        assert not stuck(time, value, rows, resolution_m=resolution(value)).any()
        assert used(run(PlainChain(settings(value, 0.1)), samples, time, value), time).all()


@pytest.mark.parametrize("late_s", [0.0, 0.0037])
def test_any_cutting_gives_the_same(late_s):
    motion = random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(7), flat="velocity")
    samples = samples_of(motion, 7)
    time = np.arange(0.5, 59.5, 0.1) + late_s
    value = motion.displacement(time)
    value[100:140], value[300:303], value[400:590] = value[100], value[300], value[400]
    value[[110, 120, 500]] = np.nan
    rng = np.random.default_rng(3)
    found = []
    for count in (0, 1, 40, 400):
        cuts = np.sort(rng.integers(1, len(samples.time_ns), count)).tolist()
        found.append(run(PlainChain(settings(value, 0.1)), samples, time, value, cuts, seed=count))
    for out in found:
        rows, expected = (joined([item for item in o if isinstance(item, Measured)]) for o in (out, found[0]))
        for name in Measured.__slots__:
            np.testing.assert_array_equal(getattr(rows, name), getattr(expected, name))
        reported, before = (sorted((e.time_ns, e.text) for e in o if isinstance(e, Event)) for o in (out, found[0]))
        assert reported == before
    assert 200 < len(joined([item for item in found[0] if isinstance(item, Measured)]).value) < 400


def test_behind_a_merge_what_is_out_of_order_is_left_out():
    motion = random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(7), flat="velocity")
    time = np.arange(0.5, 59.5, 0.1)
    shifted = time.copy()
    shifted[200:220] -= 0.55
    chain = PlainChain(settings(time, 0.1))
    merge = Merge(("displacement",))
    due = merge.push(Arrival("displacement", 0, Readings(stamps(shifted), motion.displacement(time)[:, None])))
    out = [item for one in [*due, *merge.finish()] for item in chain.push(one.record)]
    out += chain.push(samples_of(motion, 7))
    assert [event.kind for event in out if isinstance(event, Event)] == ["backwards", "gap"]
    # Five stamps lie before the newest, and the sixth is half an interval after it.
    np.testing.assert_array_equal(np.flatnonzero(~used(out, shifted)), np.arange(200, 205))


def test_a_value_waits_for_the_samples_that_reach_it():
    motion = random_motion((0.3, 8.0), 3e-3, rng=np.random.default_rng(7), flat="velocity")
    samples, time = samples_of(motion, 7), np.array([0.5, 1.0, 1.5])
    chain = PlainChain(settings(np.zeros(3), 0.5))
    assert chain.push(Readings(stamps(time), motion.displacement(time)[:, None])) == []
    assert chain.push(part(samples, slice(0, 50))) == []
    first = chain.push(part(samples, slice(50, 149)))
    np.testing.assert_array_equal(joined(first).time_ns, stamps(time[:2]))
    np.testing.assert_array_equal(joined(chain.push(part(samples, slice(149, 151)))).time_ns, stamps(time[2:]))


def test_memory_is_bounded():
    motion = Sines(np.array([1e-9]), np.array([1.0]))
    samples = samples_of(motion, 0, 300.0)
    time = np.arange(0.5, 299.0, 0.01)
    chain = PlainChain(PlainSettings("displacement", 0, 1e-8, 0.01))
    for at in range(0, len(time), 100):
        chain.push(part(samples, slice(at, at + 100)))
        chain.push(Readings(stamps(time[at : at + 100]), np.zeros((len(time[at : at + 100]), 1))))
    assert len(chain.state.time_ns) <= 801
    assert len(chain.state.run.time_ns) <= 400


def test_measurements_carry_channel_scale_and_variance():
    chain = PlainChain(PlainSettings("displacement", 3, 4e-8, 0.1, scale=2.0))
    times = np.array([0, 100, 600]) * 1_000_000
    (event,) = chain.push(Readings(times, np.array([[1.0], [np.nan], [3.0]])))
    (block,) = chain.push(samples_of(Sines(np.array([1e-9]), np.array([1.0])), 0, 1.0))
    assert (event.kind, event.time_ns, event.text) == ("gap", 0, "displacement: no values for 0.6 s.")
    np.testing.assert_array_equal(block.value, [2.0, 6.0])
    np.testing.assert_array_equal(block.channel, 3)
    np.testing.assert_array_equal(block.variance, 4e-8)
    np.testing.assert_array_equal(block.reference_variance, 0.0)
    with pytest.raises(UsageError, match="shape"):
        chain.push(Readings(times[:1], np.zeros((1, 2))))
