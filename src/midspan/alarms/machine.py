"""The states of an alarm, from one sample to the next: pending, firing, acknowledged, ended.

It fires once |x| - 1.96 sigma has been above the limit for the delay without coming below limit - hysteresis, and ends
once |x| has been below that for `keep`. While only |x| + 1.96 sigma is above the limit it is pending for the reason
`band` and does not fire. No clock: times are those of the samples.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from midspan.alarms.rules import BAND, Rule, Samples

OPEN = ("pending", "firing", "acknowledged")


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm from its begin to its end.

    value, std: at the newest sample, in `unit`; peak: the value furthest from zero. since_ns: since when the
    limit is exceeded for certain, before that since when its band touches it; time_ns: of the newest change.
    reported: the state that people were notified of last, at reported_ns; "" for none. source: which one is silent,
    "" of other rules, and silent_ns: since when.
    """

    id: str
    key: str
    point: str
    name: str
    level: str
    on: str
    unit: str
    limit: float
    state: str
    reason: str
    value: float
    std: float
    peak: float
    since_ns: int
    time_ns: int
    who: str = ""
    reported: str = ""
    reported_ns: int = 0
    source: str = ""
    silent_ns: int = 0


@dataclass(slots=True)
class RuleState:
    """alarm: the one that is open; above_ns, clear_ns: since when the value is above the limit and below it without a
    break; newest_ns: of the newest sample.
    """

    alarm: Alarm | None = None
    above_ns: int | None = None
    clear_ns: int | None = None
    newest_ns: int = 0


def advance(rule: Rule, state: RuleState, samples: Samples) -> list[Alarm]:
    """Take samples into a state; the alarm at each of its changes. Samples that the state has already are left out."""
    new = samples.after(state.newest_ns)
    if not len(new.time_ns):
        return []
    size, band = np.abs(new.value), BAND * new.std
    touched, below = size + band > rule.limit, size < rule.limit - rule.hysteresis
    if state.alarm is None and not touched.any():
        state.newest_ns = int(new.time_ns[-1])
        return []
    if state.alarm is not None and state.alarm.state != "pending" and not below.any():
        _go_on(state, state.alarm, new)
        return []
    certain = size - band > rule.limit
    rows = zip(new.time_ns.tolist(), new.value.tolist(), new.std.tolist(),
               certain.tolist(), touched.tolist(), below.tolist(), strict=True)  # fmt: skip
    changes = []
    for time_ns, value, std, is_certain, is_touched, is_below in rows:
        if rule.max_step_ns is not None and time_ns - state.newest_ns > rule.max_step_ns:
            state.above_ns = state.clear_ns = None
        state.newest_ns = time_ns
        before = state.alarm
        _count(state, time_ns, is_certain, is_below)
        state.alarm = _valued(rule, state, time_ns, value, std, is_touched)
        is_clear = is_below if before is not None and before.state != "pending" else not is_touched
        now = _next(rule, state, time_ns, is_certain=is_certain, is_clear=is_clear)
        if now is not None and (before is None or (before.state, before.reason) != (now.state, now.reason)):
            changes.append(now)
    return changes


def _go_on(state: RuleState, alarm: Alarm, samples: Samples) -> None:
    """An alarm that fires, at samples of which none is below: nothing but its values changes."""
    value, std = float(samples.value[-1]), float(samples.std[-1])
    most = float(samples.value[np.argmax(np.abs(samples.value))])
    peak = most if abs(most) > abs(alarm.peak) else alarm.peak
    state.alarm, state.clear_ns = replace(alarm, value=value, std=std, peak=peak), None
    state.newest_ns = int(samples.time_ns[-1])


def _count(state: RuleState, time_ns: int, is_certain: bool, is_below: bool) -> None:
    """Since when the limit is exceeded for certain."""
    if is_below:
        state.above_ns = None
    elif is_certain and state.above_ns is None:
        state.above_ns = time_ns


def _valued(rule: Rule, state: RuleState, time_ns: int, value: float, std: float, is_touched: bool) -> Alarm | None:
    """The open alarm with its newest value, or a new one."""
    alarm = state.alarm
    reason = "no_data" if rule.is_no_data else "limit" if state.above_ns is not None else "band"
    if alarm is None:
        if not is_touched:
            return None
        text = f"{rule.key}/{time_ns}".encode()
        # It follows from rule and instant: rows that come again after a restart are the same alarm.
        number = hashlib.blake2b(text, digest_size=8).hexdigest()
        return Alarm(number, rule.key, rule.point, rule.name, rule.level, rule.on, rule.unit, rule.limit, "pending",
                     reason, value, std, value, time_ns, time_ns)  # fmt: skip
    peak = value if abs(value) > abs(alarm.peak) else alarm.peak
    if alarm.state == "pending" and state.above_ns is not None:
        alarm = replace(alarm, reason=reason, since_ns=state.above_ns)
    return replace(alarm, value=value, std=std, peak=peak)


def _next(rule: Rule, state: RuleState, time_ns: int, *, is_certain: bool, is_clear: bool) -> Alarm | None:
    """The open alarm after a sample, ended where it is; the state holds it no longer then."""
    alarm = state.alarm
    if alarm is None:
        return None
    above_ns = time_ns - (time_ns if state.above_ns is None else state.above_ns)
    if alarm.state == "pending" and is_certain and above_ns >= rule.delay_ns:
        state.alarm, state.clear_ns = replace(alarm, state="firing", time_ns=time_ns), None
        return state.alarm
    if not is_clear:
        state.clear_ns = None
        return alarm
    state.clear_ns = time_ns if state.clear_ns is None else state.clear_ns
    if time_ns - state.clear_ns < rule.keep_ns:
        return alarm
    state.alarm = state.above_ns = state.clear_ns = None
    return replace(alarm, state="ended", time_ns=time_ns)


def acknowledged(state: RuleState, who: str, time_ns: int) -> Alarm | None:
    """A firing alarm as somebody has seen it; None where it does not fire."""
    if state.alarm is None or state.alarm.state != "firing":
        return None
    state.alarm = replace(state.alarm, state="acknowledged", who=who, time_ns=time_ns)
    return state.alarm


def message_due(alarm: Alarm, now_ns: int, repeat_ns: int, *, is_silent: bool) -> bool:
    """Whether people are to be notified of an alarm now: of each state after pending once, and of one that fires again
    and again. Of what ended before anybody heard of it nobody does.
    """
    if is_silent or alarm.state == "pending" or (alarm.state == "ended" and not alarm.reported):
        return False
    repeats = alarm.state == "firing" and now_ns - alarm.reported_ns >= repeat_ns
    return alarm.reported != alarm.state or repeats


def is_reported(alarm: Alarm) -> bool:
    """Whether nothing of an alarm is left to say, ever."""
    return alarm.state == "ended" and alarm.reported in ("", "ended")
