"""The alarms of a site's points: rows and ages in, entries for the book out. No thread, clock or network is in here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from midspan.alarms.book import Audit, Entry, Message
from midspan.alarms.drift import DailyMean
from midspan.alarms.machine import Alarm, RuleState, acknowledged, advance, is_reported, message_due
from midspan.alarms.messages import iso, silence_id, silence_tree, tree_of
from midspan.alarms.rules import Rule, Samples, rules_of, sample
from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Status
from midspan.settings.alarms import AlarmSettings, MaintenanceSettings
from midspan.store.chunk import Chunk

SILENCE, DRIFT = "silence:", "drift:"
MQTT_TARGET = "mqtt"


@dataclass(frozen=True, slots=True)
class Ages:
    """Of a point's newest row, and of the newest block of the source that is silent longest, s, and that one's name.
    came: whether there was one since the service began; else it is the time since then.
    """

    rows_s: float
    block_s: float
    rows_came: bool = True
    block_came: bool = True
    source: str = ""


@dataclass(slots=True)
class Watched:
    """A rule and how it stands; mean: of a drift."""

    rule: Rule
    state: RuleState = field(default_factory=RuleState)
    mean: DailyMean = field(default_factory=DailyMean)


class Watch:
    """alarms: of each point by its name; targets: who is notified; put: takes what is to be kept and sent.

    mqtt: whether changes go to a broker as well, which gets all of them, with their silence; targets get none that is
    silent.
    """

    def __init__(
        self,
        alarms: Mapping[str, Sequence[AlarmSettings]],
        maintenance: Sequence[MaintenanceSettings],
        targets: Sequence[str],
        put: Callable[[Entry, Sequence[dict[str, Any]]], None],
        *,
        mqtt: bool = False,
    ) -> None:
        self._put = put
        self._watched: dict[str, Watched] = {}
        self._set(alarms, maintenance, targets, mqtt=mqtt)
        self._silences: dict[str, dict[str, Any]] = {}
        # Those that ended, of which something is left to say.
        self._ended: list[Alarm] = []

    def _set(
        self,
        alarms: Mapping[str, Sequence[AlarmSettings]],
        maintenance: Sequence[MaintenanceSettings],
        targets: Sequence[str],
        *,
        mqtt: bool,
    ) -> None:
        self._maintenance, self._targets, self._mqtt = maintenance, targets, mqtt
        rules = [rule for point, own in alarms.items() for one in own for rule in rules_of(point, one)]
        # A rule that is as it was goes on in what it counts.
        self._watched = {
            rule.key: old if (old := self._watched.get(rule.key)) is not None and old.rule == rule else Watched(rule)
            for rule in rules
        }
        self._of_point = {point: [one for one in self._watched.values() if one.rule.point == point] for point in alarms}

    def change(
        self,
        alarms: Mapping[str, Sequence[AlarmSettings]],
        maintenance: Sequence[MaintenanceSettings],
        targets: Sequence[str],
        now_ns: int,
        *,
        mqtt: bool,
    ) -> None:
        """Go on with other settings: an open alarm stays where there is a rule of its name, else it ends."""
        before = self._watched
        self._set(alarms, maintenance, targets, mqtt=mqtt)
        for key, old in before.items():
            new = self._watched.get(key)
            if new is old:
                continue
            kept = {} if old.rule.on != "drift" else {DRIFT + key: old.mean.to_tree()}
            self._adopt([] if old.state.alarm is None else [old.state.alarm], kept, now_ns)
            if new is not None:
                new.state.newest_ns = max(new.state.newest_ns, old.state.newest_ns)

    def restore(self, alarms: Sequence[Alarm], kept: Mapping[str, Any], now_ns: int) -> None:
        """Go on from what the book holds; what SITE.toml no longer has has ended."""
        self._silences = {key.removeprefix(SILENCE): tree for key, tree in kept.items() if key.startswith(SILENCE)}
        self._adopt(alarms, kept, now_ns)

    def _adopt(self, alarms: Sequence[Alarm], kept: Mapping[str, Any], now_ns: int) -> None:
        """Give alarms and daily means to the rules that have their keys."""
        for key, watched in self._watched.items():
            if DRIFT + key in kept:
                watched.mean = DailyMean.of_tree(kept[DRIFT + key])
        for alarm in sorted(alarms, key=lambda one: one.time_ns):
            found = self._watched.get(alarm.key)
            if alarm.state == "ended":
                self._ended += [] if is_reported(alarm) else [alarm]
            elif found is None or found.rule.on != alarm.on:
                self._changed(replace(alarm, state="ended", time_ns=now_ns), now_ns, text="is no longer in SITE.toml")
            else:
                found.state.alarm = replace(alarm, limit=found.rule.limit, level=found.rule.level)
            if found is not None:
                # Rows up to there have been looked at.
                found.state.newest_ns = max(
                    found.state.newest_ns, alarm.time_ns if alarm.state != "acknowledged" else 0
                )

    def rows(self, point: str, rows: Chunk, now_ns: int) -> None:
        """Take a point's newest rows, in the columns of the store."""
        for one in self._of_point.get(point, ()):
            if one.rule.on == "drift":
                self._drift(one, rows, now_ns)
            elif one.rule.on in ("displacement", "velocity", "std"):
                self._take(one, samples_of(one.rule.on, rows), now_ns)

    def new_datum(self, point: str, time_ns: int) -> None:
        """A point's displacement counts from another zero."""
        for one in self._of_point.get(point, ()):
            if one.rule.on == "drift":
                one.mean.restart(time_ns)

    def tick(self, now_ns: int, ages: Mapping[str, Ages], disk_percent: float | None) -> None:
        """Look at what does not come, and at how much of the disk is used, %; ages: by the points' names."""
        for one in self._watched.values():
            if one.rule.on == "disk" and disk_percent is not None:
                self._take(one, sample(now_ns, disk_percent), now_ns)
            elif (age := ages.get(one.rule.point)) is not None and one.rule.on in ("no_data", "silent"):
                self._look_at_age(one, age, now_ns)
        for key, silence in list(self._silences.items()):
            if silence["until_ns"] <= now_ns:
                self._unsilenced(key, now_ns, "")
        for alarm in self._ended:
            self._report_again(alarm, now_ns)
        self._ended = [alarm for alarm in self._ended if not is_reported(alarm)]
        for alarm in [one.state.alarm for one in self._watched.values() if one.state.alarm is not None]:
            self._report_again(alarm, now_ns)

    def _look_at_age(self, one: Watched, age: Ages, now_ns: int) -> None:
        """Look at what does not come. Soon after a restart it is not known whether what was away before still is."""
        value, came = (age.block_s, age.block_came) if one.rule.on == "silent" else (age.rows_s, age.rows_came)
        if came or value > one.rule.limit:
            source = age.source if one.rule.on == "silent" and value > one.rule.limit else ""
            self._take(one, sample(now_ns, value), now_ns, source)

    # What people do

    def limits(self) -> list[dict[str, Any]]:
        """The limit of each rule, in the unit of its value."""
        rules = [one.rule for one in self._watched.values()]
        return [
            {"point": rule.point, "name": rule.name, "on": rule.on, "level": rule.level,
             "limit": round(rule.limit, 6), "unit": rule.unit}
            for rule in rules
        ]  # fmt: skip

    def trees(self) -> list[dict[str, Any]]:
        """The open alarms with their newest values."""
        return [self._tree(one.state.alarm) for one in self._watched.values() if one.state.alarm is not None]

    def acknowledge(self, number: str, who: str, now_ns: int) -> str:
        """Somebody has seen a firing alarm: it is not repeated any more. Raises MidspanError where it does not fire."""
        one = self._open(number)
        alarm = acknowledged(one.state, who, now_ns)
        if alarm is None:
            state = one.state.alarm.state if one.state.alarm is not None else "ended"
            raise MidspanError(f"{number}: is {state}; only a firing alarm can be acknowledged.")
        self._changed(alarm, now_ns, who=who)
        return f"{alarm.point}: {alarm.name} is acknowledged."

    def silence(self, number: str, who: str, until_ns: int, reason: str, now_ns: int) -> str:
        """Send no messages about an alarm, nor about the next ones of its rule, until an instant."""
        if until_ns <= now_ns:
            raise MidspanError(f"until: must be in the future; received {iso(until_ns)}.")
        one = self._open(number)
        tree = {"until_ns": until_ns, "until": iso(until_ns), "owner": who, "reason": reason}
        self._silences[one.rule.key] = tree
        audit = Audit(now_ns, number, "silenced", who, f"until {iso(until_ns)}: {reason}")
        self._note(audit, one, {SILENCE + one.rule.key: tree})
        return f"{one.rule.point}: {one.rule.name} is silenced until {iso(until_ns)}."

    def unsilence(self, number: str, who: str, now_ns: int) -> str:
        """End a silence."""
        key = self._open(number).rule.key
        if key not in self._silences:
            raise MidspanError(f"{number}: is not silenced.")
        self._unsilenced(key, now_ns, who)
        return f"{key}: is no longer silent."

    def silences(self) -> list[dict[str, Any]]:
        """The silences in force, of rules with an open alarm or without one."""
        return [silence_tree(key, tree) for key, tree in self._silences.items()]

    def end_silence(self, number: str, who: str, now_ns: int) -> str:
        """End a silence by its own id. Raises MidspanError where there is none."""
        key = next((key for key in self._silences if silence_id(key) == number), None)
        if key is None:
            raise MidspanError(f"{number}: is not a silence. GET /api/v1/alarms/silences lists them.")
        self._unsilenced(key, now_ns, who)
        return f"{key}: is no longer silent."

    def test(self, who: str, site: str, now_ns: int) -> str:
        """Send a message to every target, which says that it is a test."""
        alarm = Alarm("test", "", "test", "test", "warning", "displacement", "mm", 0.0, "test", "test", 0.0, 0.0, 0.0,
                      now_ns, now_ns, who)  # fmt: skip
        tree = {**tree_of(alarm), "text": f"This is a test of the alarms of {site}, sent by {who}."}
        targets = [*self._targets, *[MQTT_TARGET] * self._mqtt]
        messages = [Message(target, now_ns, "test/alarm", tree) for target in targets]
        audit = [Audit(now_ns, "test", "test", who, ", ".join(targets))]
        self._put(Entry(audit=audit, messages=messages), [tree])
        return f"Test message sent to {', '.join(targets) or 'nobody: there is no [[notify]]'}."

    def _open(self, number: str) -> Watched:
        for one in self._watched.values():
            if one.state.alarm is not None and one.state.alarm.id == number:
                return one
        raise MidspanError(f"{number}: is not an open alarm. GET /api/v1/alarms lists them.")

    # Changes

    def _take(self, one: Watched, samples: Samples, now_ns: int, source: str = "") -> None:
        last = one.state.alarm
        changes = advance(one.rule, one.state, samples)
        if source and one.state.alarm is not None:
            # One that is about to end keeps the name of the source that was silent.
            silent_ns = now_ns - round(float(samples.value[-1]) * NANOSECONDS)
            one.state.alarm = replace(one.state.alarm, source=source, silent_ns=silent_ns)
            changes = [replace(alarm, source=source, silent_ns=silent_ns) for alarm in changes]
        for alarm in changes:
            if last is not None and last.id == alarm.id:
                alarm = replace(alarm, reported=last.reported, reported_ns=last.reported_ns)
            last = self._changed(alarm, now_ns)

    def _drift(self, one: Watched, rows: Chunk, now_ns: int) -> None:
        good = (rows.columns["status"] != Status.LOST) & (rows.time_ns >= one.mean.datum_ns)
        std = 1e3 * np.asarray(rows.columns["std_m"], dtype=np.float64)
        # The zero's is that of both days.
        zero = 1e3 * np.asarray(rows.columns.get("zero_std_m", np.zeros(len(std))), dtype=np.float64)
        value = 1e3 * np.asarray(rows.columns["displacement_m"], dtype=np.float64)
        hour = one.mean.hour
        drift = one.mean.add(rows.time_ns[good], value[good], np.maximum(std**2 - zero**2, 0.0)[good])
        if drift is not None:
            self._take(one, sample(*drift), now_ns)
        if one.mean.hour > hour:
            self._put(Entry(kept={DRIFT + one.rule.key: one.mean.to_tree()}), ())

    def _is_silent(self, alarm: Alarm, now_ns: int) -> bool:
        silence = self._silences.get(alarm.key)
        if silence is not None and now_ns < silence["until_ns"]:
            return True
        return any(window.covers(alarm.point, now_ns / 1e9) for window in self._maintenance)

    def _tree(self, alarm: Alarm) -> dict[str, Any]:
        silence = self._silences.get(alarm.key)
        return tree_of(alarm, None if silence is None else {key: silence[key] for key in ("until", "owner", "reason")})

    def _changed(self, alarm: Alarm, now_ns: int, who: str = "", text: str = "") -> Alarm:
        """Keep a change, and send what is due; returns the alarm with what people were notified of."""
        alarm, messages = self._due(alarm, now_ns)
        tree = self._tree(alarm)
        if self._mqtt:
            messages = [Message(MQTT_TARGET, now_ns, f"{alarm.point}/alarm", tree), *messages]
        audit = Audit(now_ns, alarm.id, alarm.state, who, text or tree["text"])
        self._put(Entry([alarm], [audit], messages), [tree])
        if alarm.state == "ended" and not is_reported(alarm):
            self._ended.append(alarm)
        return alarm

    def _report_again(self, alarm: Alarm, now_ns: int) -> None:
        """Send what is due of an alarm that has not changed."""
        reported, messages = self._due(alarm, now_ns)
        if messages:
            self._put(
                Entry([reported], [Audit(now_ns, alarm.id, "notified", "", f"{reported.state}, again")], messages), ()
            )
            self._ended = [reported if one.id == reported.id else one for one in self._ended]

    def _due(self, alarm: Alarm, now_ns: int) -> tuple[Alarm, list[Message]]:
        """An alarm with what people are notified of it from now on, and the messages."""
        found = self._watched.get(alarm.key)
        repeat_ns = found.rule.repeat_ns if found is not None else 0
        if not self._targets or not message_due(alarm, now_ns, repeat_ns, is_silent=self._is_silent(alarm, now_ns)):
            return (replace(alarm, reported="ended") if alarm.state == "ended" and not self._targets else alarm), []
        alarm = replace(alarm, reported=alarm.state, reported_ns=now_ns)
        if found is not None and found.state.alarm is not None and found.state.alarm.id == alarm.id:
            found.state.alarm = replace(found.state.alarm, reported=alarm.reported, reported_ns=now_ns)
        tree = self._tree(alarm)
        return alarm, [Message(target, now_ns, "", tree) for target in self._targets]

    def _note(self, audit: Audit, one: Watched | None, kept: dict[str, Any]) -> None:
        """Keep a silence, or its end; the page gets the open alarm of its rule with it."""
        alarm = None if one is None else one.state.alarm
        self._put(Entry(audit=[audit], kept=kept), [] if alarm is None else [self._tree(alarm)])

    def _unsilenced(self, key: str, now_ns: int, who: str) -> None:
        del self._silences[key]
        one = self._watched.get(key)
        number = one.state.alarm.id if one is not None and one.state.alarm is not None else ""
        self._note(Audit(now_ns, number, "silence ended", who, key), one, {SILENCE + key: None})


def samples_of(on: str, rows: Chunk) -> Samples:
    """Rows as what a rule watches, in mm or mm/s; of a displacement those that are lost say nothing. The store has no
    standard deviation of the velocity.
    """
    std = 1e3 * np.asarray(rows.columns["std_m"], dtype=np.float64)
    none = np.zeros(len(std))
    if on == "std":
        return Samples(rows.time_ns, std, none)
    good = rows.columns["status"] != Status.LOST
    if on == "velocity":
        return Samples(rows.time_ns[good], 1e3 * np.asarray(rows.columns["velocity_m_s"], np.float64)[good], none[good])
    return Samples(rows.time_ns[good], 1e3 * np.asarray(rows.columns["displacement_m"], np.float64)[good], std[good])
