"""Faults of sensors, clocks and networks through a whole point: an event, a band that holds, never decimetres."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from midspan.engine.axis import usual_figures
from midspan.engine.guard import Guard, GuardSettings
from midspan.engine.merge import Merge
from midspan.engine.plain import PlainChain, PlainSettings
from midspan.engine.point import ACCELEROMETER, Point
from midspan.engine.sensors import PlainSensor, Seen
from midspan.fusion.estimator import Estimator, Rows
from midspan.fusion.model import EstimatorSettings
from midspan.records import Arrival, Channel, Estimate, Event, Readings, Source, Tick, joined
from midspan.simulate.motion.motion import random_motion

NOISE_A, NOISE_M, BIAS = 2e-3, 1e-4, 0.03
RATE_HZ, LEVEL_HZ, LENGTH_S = 100.0, 30.0, 45.0
# Readings in one arrival.
BLOCK = {ACCELEROMETER: 5, "level": 1}
MOTION = random_motion((0.5, 6.0), 2e-3, rng=np.random.default_rng(5), flat="velocity")


@dataclass
class Stream:
    """What a sensor sends: true times, its own stamps and values (n,), and by how much each arrives late, s."""

    true_s: np.ndarray
    stamp_s: np.ndarray
    value: np.ndarray
    delay_s: np.ndarray

    def without(self, start_s, stop_s):
        kept = (self.true_s < start_s) | (self.true_s >= stop_s)
        return Stream(self.true_s[kept], self.stamp_s[kept], self.value[kept], self.delay_s[kept])


def recorded(seed=1):
    """An accelerometer, which sends at once, and a displacement sensor, 20 ms late."""
    rng = np.random.default_rng(seed)
    times = [np.arange(0.0, LENGTH_S, 1 / rate) for rate in (RATE_HZ, LEVEL_HZ)]
    acceleration = MOTION.acceleration(times[0]) + BIAS + rng.normal(0, NOISE_A, len(times[0]))
    value = MOTION.displacement(times[1]) + rng.normal(0, NOISE_M, len(times[1]))
    return {
        ACCELEROMETER: Stream(times[0], times[0].copy(), acceleration, np.zeros(len(times[0]))),
        "level": Stream(times[1], times[1].copy(), value, np.full(len(times[1]), 0.02)),
    }


SOUND = recorded()[ACCELEROMETER].value


def journal(streams):
    """Arrivals and ticks in the order in which they come."""
    items = []
    for name, s in streams.items():
        stamps = np.rint(s.stamp_s * 1e9).astype(np.int64)
        count = BLOCK[name]
        for k in range(0, len(stamps), count):
            block = slice(k, k + count)
            came_s = float(np.max(s.true_s[block] + s.delay_s[block]))
            items.append((came_s, Arrival(name, k // count, Readings(stamps[block], s.value[block, None]))))
    items += [(second, Tick(round(second * 1e9))) for second in np.arange(0.0, LENGTH_S, 0.25)]
    return [item for _, item in sorted(items, key=lambda pair: pair[0])]


def a_point(lateness_s=0.5):
    merge = Merge((ACCELEROMETER, "level"), lateness_s)
    figures = replace(usual_figures(SOUND, RATE_HZ), name="accel", noise_density=NOISE_A**2 / RATE_HZ)
    chain = PlainChain(PlainSettings("level", 0, NOISE_M**2, 1 / LEVEL_HZ))
    channel = Channel("level", Source.DISPLACEMENT, 1.0)
    settings = EstimatorSettings((channel,), bias_m_s2=(BIAS,), bias_std_m_s2=(0.01,))
    sensors = {"level": PlainSensor("level", chain)}
    return Point(merge, Guard(GuardSettings(RATE_HZ, (figures,))), sensors, Estimator(settings))


def run(streams):
    """Estimate of the measured rows, all events and the health of the streams."""
    point, outputs = a_point(), []
    for item in journal(streams):
        outputs += point.push(item)
    outputs += point.finish()
    events = [item for item in outputs if isinstance(item, Event)]
    events += [event for item in outputs if isinstance(item, Rows | Seen) for event in item.events]
    rows = joined([item.estimates[0] for item in outputs if isinstance(item, Rows) and item.estimates])
    return rows, events, point.merge.health


def late_by(delay_s):
    def spoil(streams):
        streams["level"].delay_s[:] = delay_s
        return streams

    return spoil


def not_numbers(name):
    def spoil(streams):
        stream = streams[name]
        stream.value[(stream.true_s > 30.0) & (stream.true_s < 30.4)] = np.nan
        stream.value[(stream.true_s > 40.0) & (stream.true_s < 40.05)] = np.inf
        return streams

    return spoil


def gap(name):
    return lambda streams: {**streams, name: streams[name].without(30.0, 33.0)}


def clock_step(names, step_s):
    def spoil(streams):
        for name in names:
            streams[name].stamp_s[streams[name].true_s >= 30.0] += step_s
        return streams

    return spoil


def errors(streams, rows, reference):
    """Error (m) of each row, by the true time of the sample of `reference` with that stamp; NaN where two have it."""
    stamps = np.rint(streams[reference].stamp_s * 1e9).astype(np.int64)
    order = np.maximum.accumulate(np.concatenate(([-1], stamps[:-1]))) < stamps
    at = np.searchsorted(stamps[order], rows.time_ns)
    return rows.displacement_m - MOTION.displacement(streams[reference].true_s[order][at])


CASES = {
    "level 0.1 s late": (late_by(0.1), set()),
    "level 0.4 s late": (late_by(0.4), set()),
    "level 0.5 s late": (late_by(0.5), set()),
    "level 0.52 s late": (late_by(0.52), {"late"}),
    "level 0.6 s late": (late_by(0.6), {"late"}),
    "accel not numbers": (not_numbers(ACCELEROMETER), {"bridged"}),
    "level not numbers": (not_numbers("level"), {"gap"}),
    "accel gap": (gap(ACCELEROMETER), {"gap"}),
    "level gap": (gap("level"), {"gap"}),
    "accel clock +0.3 s": (clock_step([ACCELEROMETER], 0.3), {"gap"}),
    "accel clock -0.3 s": (clock_step([ACCELEROMETER], -0.3), {"backwards"}),
    "level clock +0.3 s": (clock_step(["level"], 0.3), {"gap"}),
    "level clock -0.3 s": (clock_step(["level"], -0.3), {"backwards"}),
    "both clocks +0.3 s": (clock_step([ACCELEROMETER, "level"], 0.3), {"gap"}),
    "both clocks -0.3 s": (clock_step([ACCELEROMETER, "level"], -0.3), {"backwards"}),
}
# The filter has no state for a clock that steps against the other one: its velocity comes out wrong, and it goes on.
NO_CLOCK_STATE = {"accel clock +0.3 s", "accel clock -0.3 s"}
MAX_ERROR_M = 0.1


@pytest.mark.parametrize("name", CASES)
def test_a_fault_is_an_event_and_no_row_is_off_by_decimetres(name, request):
    spoil, kinds = CASES[name]
    streams = spoil(recorded())
    rows, events, health = run(streams)
    assert {event.kind for event in events} == kinds
    assert len(events) <= 4
    assert np.all(np.diff(rows.time_ns) > 0)
    assert np.all(np.isfinite(rows.displacement_m) & np.isfinite(rows.variance_m2))
    late = len(streams["level"].value) if name == "level 0.6 s late" else 0
    assert health[1].late >= late - 0.5 * LEVEL_HZ if late else (health[1].late > 0) == ("late" in kinds)
    if name in NO_CLOCK_STATE:
        request.applymarker(pytest.mark.xfail(strict=True, reason="the filter has no state for the clock"))
    error = errors(streams, rows, ACCELEROMETER)
    assert np.max(np.abs(error)) < MAX_ERROR_M
    # Where the sensors agree on the time, the band holds as without a fault: 95 % within 1.96 sigma, within 5 at most.
    if not name.startswith("level clock"):
        ratio = np.abs(error) / np.sqrt(rows.variance_m2)
        assert np.mean(ratio < 1.96) > 0.93
        assert np.max(ratio) < 5.0


def test_without_a_fault_there_is_no_event():
    streams = recorded()
    rows, events, health = run(streams)
    assert events == []
    assert len(rows.time_ns) == len(streams[ACCELEROMETER].value)
    assert health[1].used == len(streams["level"].value)


def test_a_late_sensor_gives_what_one_in_time_gives():
    first, _, _ = run(recorded())
    again, _, _ = run(late_by(0.4)(recorded()))
    for name in Estimate.__slots__:
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


def test_a_record_of_any_length_may_come_in_one_push():
    time_ns = np.arange(70_000) * 50_000_000
    motion = MOTION.displacement(time_ns / 1e9)
    point, outputs = a_point(lateness_s=np.inf), []
    for name, value in ((ACCELEROMETER, MOTION.acceleration(time_ns / 1e9) + BIAS), ("level", motion)):
        outputs += point.push(Arrival(name, 0, Readings(time_ns, value[:, None])))
    outputs += point.finish()
    rows = joined([item.estimates[0] for item in outputs if isinstance(item, Rows) and item.estimates])
    np.testing.assert_array_equal(rows.time_ns, time_ns)
