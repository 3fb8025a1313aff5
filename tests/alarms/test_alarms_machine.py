"""An alarm's states over rows of a structure: what is certain fires, and nothing fires twice."""

import numpy as np
import pytest

from midspan.alarms.machine import RuleState, acknowledged, advance, message_due
from midspan.alarms.messages import sentence_of
from midspan.alarms.rules import Samples, rules_of, sample
from midspan.records import NANOSECONDS
from midspan.settings.alarms import AlarmSettings

T0 = 1_790_000_000 * NANOSECONDS
RATE = 100


def rule(**keys):
    settings = {"name": "a", "on": "displacement", "limit_mm": 20.0, "keep_firing_s": 1.0, **keys}
    return rules_of("p", AlarmSettings.model_validate(settings))[0]


def rows(value_mm, std_mm=0.1, begin_s=0.0):
    value = np.atleast_1d(np.asarray(value_mm, dtype=np.float64))
    time_ns = T0 + np.round((begin_s + np.arange(len(value)) / RATE) * NANOSECONDS).astype(np.int64)
    return Samples(time_ns, value, np.broadcast_to(np.asarray(std_mm, dtype=np.float64), value.shape))


def states(changes):
    return [one.state for one in changes]


def held(mm, seconds):
    return np.full(round(seconds * RATE), mm)


def at_s(alarm):
    return (alarm.time_ns - T0) / NANOSECONDS


def since_s(alarm):
    return (alarm.since_ns - T0) / NANOSECONDS


def test_it_fires_after_its_delay_and_ends_below_the_hysteresis_for_as_long_as_it_keeps_firing():
    own, state = rule(delay_s=2.0, hysteresis_mm=2.0), RuleState()
    # A slow load: above the limit, between limit and hysteresis, below.
    changes = advance(own, state, rows(np.r_[held(0, 1), held(25, 3), held(19, 3), held(10, 3)]))
    assert states(changes) == ["pending", "firing", "ended"]
    assert len({one.id for one in changes}) == 1
    # Within a row of: 1 s; 2 s after that; 1 s after the value is below 18 mm.
    assert [at_s(one) for one in changes] == pytest.approx([1.0, 3.0, 8.0], abs=1.5 / RATE)
    assert changes[-1].peak == 25.0
    assert state.alarm is None


def test_a_negative_displacement_exceeds_a_limit_too():
    (change,) = advance(rule(), RuleState(), rows(held(-25, 0.1)))
    assert (change.state, change.value) == ("firing", -25.0)


def test_a_value_that_is_above_the_limit_for_less_than_the_delay_never_fires():
    own, state = rule(delay_s=2.0), RuleState()
    # 0.4 Hz: above the limit for 0.7 s each half period.
    time_s = np.arange(0, 60, 1 / RATE)
    changes = advance(own, state, rows(30.0 * np.sin(2 * np.pi * 0.4 * time_s)))
    # One alarm that waits, not one at each crest: first its band is above the limit, then its value.
    assert [(one.state, one.reason) for one in changes] == [("pending", "band"), ("pending", "limit")]
    assert states(advance(own, state, rows(held(0, 3), begin_s=60.0))) == ["ended"]


def test_it_does_not_fire_on_a_value_between_limit_and_hysteresis():
    own, state = rule(delay_s=2.0, hysteresis_mm=5.0, keep_firing_s=10.0), RuleState()
    # The delay is over at 17 mm, which is below the limit of 20 mm; it fires with the next certain row.
    changes = advance(own, state, rows(np.r_[held(25, 1), held(17, 3), held(25, 1)]))
    assert [(one.state, round(at_s(one), 1)) for one in changes] == [("pending", 0.0), ("firing", 4.0)]


def test_only_the_band_touches_the_limit():
    own, state = rule(), RuleState()
    # 19 mm +- 1.96 mm: it may be above 20 mm, and may not.
    (change,) = advance(own, state, rows(held(19, 60), 1.0))
    assert (change.state, change.reason) == ("pending", "band")
    # 21 mm +- 1.96 mm is not certain either; 22.1 mm is.
    assert advance(own, state, rows(held(21, 10), 1.0, begin_s=60.0)) == []
    (change,) = advance(own, state, rows(held(22.1, 1), 1.0, begin_s=70.0))
    assert (change.state, change.reason) == ("firing", "limit")
    # A camera that is covered: the band grows, and what was certain does not end by that.
    assert advance(own, state, rows(held(22.1, 60), 50.0, begin_s=71.0)) == []


def test_it_fires_since_its_value_is_above_the_limit_and_not_since_its_band_is():
    own, state = rule(delay_s=2.0), RuleState()
    # The band touches the limit for a minute, in which the value is above it for a second.
    changes = advance(own, state, rows(np.r_[held(19, 30), held(25, 1), held(19, 30)], 1.0))
    assert [(one.state, one.reason) for one in changes] == [("pending", "band"), ("pending", "limit")]
    assert [since_s(one) for one in changes] == pytest.approx([0.0, 30.0])
    assert sentence_of(state.alarm).endswith(
        "was exceeded by the whole band at 2026-09-21T14:13:50.000Z, for too short a time to fire."
    )
    # Above it for good, but for an instant below.
    (fires,) = advance(own, state, rows(np.r_[held(25, 1), held(-19, 0.1), held(-26, 5)], 1.0, begin_s=61.0))
    assert (fires.state, since_s(fires)) == ("firing", pytest.approx(62.1))
    advance(own, state, rows(np.r_[held(-31, 1), held(18, 0.1)], 5.0, begin_s=67.1))
    said = sentence_of(state.alarm)
    assert said.startswith("p: displacement 18 mm ± 9.8 mm, limit 20 mm: exceeded by the whole band, since ")
    assert said.endswith("2026-09-21T14:14:22.100Z. Peak -31 mm.")
    (ends,) = advance(own, state, rows(held(0, 2), begin_s=70.0))
    assert (ends.state, since_s(ends)) == ("ended", pytest.approx(62.1))


def test_after_a_gap_a_delay_begins_anew_and_what_fires_goes_on():
    own, state = rule(delay_s=2.0), RuleState()
    changes = advance(own, state, rows(held(25, 1)))
    # An hour without rows says nothing of what was between.
    changes += advance(own, state, rows(held(25, 1), begin_s=3600.0))
    assert states(changes) == ["pending"]
    changes = advance(own, state, rows(held(25, 1.5), begin_s=3601.0))
    assert states(changes) == ["firing"]
    assert at_s(changes[0]) == pytest.approx(3602.0, abs=1.5 / RATE)
    assert advance(own, state, rows(held(5, 0.5), begin_s=7200.0)) == []
    assert states(advance(own, state, rows(held(5, 2.0), begin_s=7201.0))) == ["ended"]


@pytest.mark.parametrize("size", [1, 7, 100, 5000])
def test_any_cutting_of_the_rows_gives_the_same_changes(size):
    time_s = np.arange(0, 40, 1 / RATE)
    value = 15.0 * np.sin(2 * np.pi * 0.05 * time_s) + 9.0 * np.sin(2 * np.pi * 0.7 * time_s)
    all_rows, own = rows(value, 0.5), rule(delay_s=0.2, hysteresis_mm=3.0)
    whole = advance(own, RuleState(), all_rows)
    assert len(whole) >= 4
    state, cut = RuleState(), []
    for k in range(0, len(value), size):
        part = slice(k, k + size)
        cut += advance(own, state, Samples(all_rows.time_ns[part], all_rows.value[part], all_rows.std[part]))
    assert cut == whole


def test_rows_that_come_again_are_the_same_alarm():
    own = rule(delay_s=1.0)
    first, second = RuleState(), RuleState()
    (a, b), again = advance(own, first, rows(held(25, 2))), advance(own, second, rows(held(25, 2)))
    assert [a, b] == again
    assert advance(own, first, rows(held(25, 2))) == []


def test_two_limits_at_once_are_two_alarms():
    warning, critical = rule(name="w", limit_mm=10.0), rule(name="c", limit_mm=20.0, level="critical")
    value = rows(np.r_[held(0, 1), held(15, 1), held(25, 1)])
    found = [advance(one, RuleState(), value)[0] for one in (warning, critical)]
    assert [(one.level, round(at_s(one), 2)) for one in found] == [("warning", 1.0), ("critical", 2.0)]
    assert found[0].id != found[1].id


def test_a_span_is_a_limit():
    settings = {"name": "a", "on": "displacement", "span_m": 45.0, "span_over": 800}
    assert rules_of("p", AlarmSettings.model_validate(settings))[0].limit == pytest.approx(56.25)


def test_no_data_is_an_alarm_of_its_own():
    settings = AlarmSettings.model_validate({"name": "a", "on": "displacement", "limit_mm": 20.0, "no_data_s": 60.0})
    of_limit, of_rows = rules_of("p", settings)
    state = RuleState()
    assert advance(of_rows, state, sample(T0, 59.0)) == []
    (change,) = advance(of_rows, state, sample(T0 + NANOSECONDS, 60.5))
    assert (change.state, change.reason, change.unit) == ("firing", "no_data", "s")
    assert of_limit.key != of_rows.key
    # Rows are there again, for the 10 s that are usual.
    assert advance(of_rows, state, sample(T0 + 10 * NANOSECONDS, 0.1)) == []
    assert states(advance(of_rows, state, sample(T0 + 20 * NANOSECONDS, 0.1))) == ["ended"]


def test_an_acknowledged_alarm_is_not_repeated():
    own, state = rule(repeat_s=60.0), RuleState()
    (fires,) = advance(own, state, rows(held(25, 1)))
    minute = 60 * NANOSECONDS
    assert message_due(fires, T0, minute, is_silent=False)
    assert not message_due(fires, T0, minute, is_silent=True)
    seen = acknowledged(state, "anna", T0 + NANOSECONDS)
    assert (seen.state, seen.who) == ("acknowledged", "anna")
    assert acknowledged(state, "anna", T0) is None
    assert states(advance(own, state, rows(held(0, 3), begin_s=2.0))) == ["ended"]


def test_values_that_are_no_numbers_say_nothing():
    own, state = rule(), RuleState()
    assert advance(own, state, rows(np.full(10, np.nan))) == []
    assert advance(own, state, rows(held(1e9, 0.1), np.inf, begin_s=1.0)) == []
    assert state.newest_ns == 0
