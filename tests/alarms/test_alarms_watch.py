"""The alarms of a site: who is notified of what and when, silences, maintenance, and what a restart keeps."""

import numpy as np
import pytest

from midspan.alarms.book import Book
from midspan.alarms.messages import iso
from midspan.alarms.watch import Ages, Watch
from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Status
from midspan.settings.alarms import AlarmSettings, MaintenanceSettings
from midspan.store.chunk import Chunk

T0 = 1_790_000_000 * NANOSECONDS
TARGET = "http://example.org 1"


def s(seconds):
    return T0 + round(seconds * NANOSECONDS)


class Site:
    """A watch, what it gave, and the book that it goes on from."""

    def __init__(self, folder, alarms=(), maintenance=(), mqtt=True):
        usual = {"name": "a", "on": "displacement", "limit_mm": 20.0, "keep_firing_s": 0.0, "repeat_s": 60.0}
        settings = [AlarmSettings.model_validate({**usual, **one}) for one in (alarms or [{}])]
        windows = [MaintenanceSettings.model_validate(one) for one in maintenance]
        self.book, self.entries, self.trees = Book(folder), [], []
        self.watch = Watch({"p": settings}, windows, [TARGET], self.put, mqtt=mqtt)
        self.watch.restore(self.book.alarms(), self.book.kept(), T0)

    def put(self, entry, trees):
        self.entries.append(entry)
        self.trees += trees
        self.book.write(entry)

    def move(self, mm, begin_s, seconds=1.0, status=Status.TRACKING):
        count = round(100 * seconds)
        time_ns = s(begin_s) + 10_000_000 * np.arange(count)
        columns = {
            "displacement_m": np.full(count, 1e-3 * mm), "std_m": np.full(count, 1e-4, dtype=np.float32),
            "velocity_m_s": np.zeros(count, dtype=np.float32), "status": np.full(count, int(status), dtype=np.int8),
            "zero_std_m": np.zeros(count, dtype=np.float32),
        }  # fmt: skip
        self.watch.rows("p", Chunk("p", "rows", time_ns, columns), s(begin_s + seconds))

    def tick(self, at_s, rows_s=0.0, block_s=0.0, disk=None, *, came=True):
        self.watch.tick(s(at_s), {"p": Ages(rows_s, block_s, came, came)}, disk)

    def reported(self, target=TARGET):
        return [m.tree["state"] for one in self.entries for m in one.messages if m.target == target]

    @property
    def id(self):
        (tree,) = self.watch.trees()
        return tree["id"]


@pytest.fixture
def site(tmp_path):
    return Site(tmp_path)


def test_people_get_each_state_once_and_mqtt_all_of_them(tmp_path):
    site = Site(tmp_path, [{"delay_s": 0.5}])
    site.move(25, 0)
    for at_s in (1.0, 1.25, 1.5):
        site.tick(at_s)
    site.watch.acknowledge(site.id, "anna", s(2))
    site.move(0, 2)
    assert site.reported() == ["firing", "acknowledged", "ended"]
    assert site.reported("mqtt") == ["pending", "firing", "acknowledged", "ended"]
    assert [(one.what, one.who) for one in reversed(site.book.audit(10))] == [
        ("pending", ""), ("firing", ""), ("acknowledged", "anna"), ("ended", ""),
    ]  # fmt: skip


def test_a_peak_within_one_block_is_told_from_its_begin_to_its_end(site):
    site.move(0, 0)
    rows = np.r_[0.0, 25.0, 0.0]
    columns = {"displacement_m": 1e-3 * rows, "std_m": np.full(3, 1e-4), "status": np.zeros(3, dtype=np.int8)}
    site.watch.rows("p", Chunk("p", "rows", s(1) + 10_000_000 * np.arange(3), columns), s(1.1))
    assert site.reported() == ["firing", "ended"]


def test_it_is_repeated_until_it_is_acknowledged(site):
    site.move(25, 0)
    for at_s in range(1, 200):
        site.tick(at_s)
    assert site.reported() == ["firing"] * 4
    site.watch.acknowledge(site.id, "anna", s(200))
    for at_s in range(200, 400):
        site.tick(at_s)
    assert site.reported() == [*["firing"] * 4, "acknowledged"]
    with pytest.raises(MidspanError, match="is acknowledged"):
        site.watch.acknowledge(site.id, "anna", s(401))


def test_a_silence_has_an_owner_a_reason_and_an_end(site):
    site.move(25, 0)
    site.watch.silence(site.id, "anna", s(600), "gauge is loose", s(1))
    (tree,) = site.watch.trees()
    assert tree["silence"]["owner"] == "anna"
    # The page gets it at once.
    assert site.trees[-1] == tree
    assert tree["silence"]["reason"] == "gauge is loose"
    site.move(0, 2)
    # The next one of the same rule is silent as well; MQTT gets it.
    site.move(25, 4)
    for at_s in range(5, 600):
        site.tick(at_s)
    assert site.reported() == ["firing"]
    assert site.reported("mqtt") == ["firing", "ended", "firing"]
    # Then what people have not heard of yet is said.
    site.tick(601)
    assert site.reported() == ["firing", "ended", "firing"]
    assert "silenced" in [one.what for one in site.book.audit(10)]
    with pytest.raises(MidspanError, match="future"):
        site.watch.silence(site.id, "anna", s(1), "x", s(601))


def test_what_fired_and_ended_while_it_was_silent_is_never_said(site):
    site.move(25, 0)
    site.watch.silence(site.id, "anna", s(600), "x", s(1))
    site.move(0, 2)
    site.move(25, 4)
    site.move(0, 6)
    site.tick(601)
    # Only the end of the one that people were notified of.
    assert site.reported() == ["firing", "ended"]


def test_maintenance_silences_messages_and_nothing_else(tmp_path):
    window = {"begin": "2026-09-21T00:00:00Z", "end": "2036-09-23T00:00:00Z", "reason": "bearing"}
    site = Site(tmp_path, maintenance=[window])
    site.move(25, 0)
    site.tick(2)
    assert site.reported() == []
    assert site.reported("mqtt") == ["firing"]
    assert site.watch.trees()[0]["state"] == "firing"


def test_a_restart_keeps_the_alarm_and_says_nothing_twice(tmp_path):
    before = Site(tmp_path)
    before.move(25, 0)
    number = before.id
    # The rows of the last second come again.
    after = Site(tmp_path)
    after.move(25, 0)
    after.move(25, 1)
    after.tick(3)
    assert after.id == number
    assert after.reported() == []
    after.watch.acknowledge(number, "anna", s(4))
    after.move(0, 5)
    assert after.reported() == ["acknowledged", "ended"]
    again = Site(tmp_path)
    again.move(0, 6)
    again.tick(8)
    assert again.reported() == []


def test_a_silence_holds_over_a_restart(tmp_path):
    before = Site(tmp_path)
    before.move(25, 0)
    before.watch.silence(before.id, "anna", s(600), "x", s(1))
    after = Site(tmp_path)
    for at_s in range(2, 500):
        after.tick(at_s)
    assert after.reported() == []
    after.watch.unsilence(after.id, "anna", s(500))
    after.tick(501)
    assert after.reported() == ["firing"]


def test_an_alarm_that_is_no_longer_in_the_settings_has_ended(tmp_path):
    Site(tmp_path).move(25, 0)
    after = Site(tmp_path, [{"name": "b"}])
    assert after.reported("mqtt") == ["ended"]
    assert after.watch.trees() == []


def test_rows_that_do_not_come_are_an_alarm(tmp_path):
    site = Site(tmp_path, [{"name": "rows", "no_data_s": 60.0}])
    site.tick(0, rows_s=59.0)
    site.tick(2, rows_s=61.0)
    assert [(tree["reason"], tree["unit"]) for tree in site.trees] == [("no_data", "s")]


def test_a_restart_does_not_end_an_outage_that_goes_on(tmp_path):
    rules = [{"name": "rows", "no_data_s": 60.0}]
    Site(tmp_path, rules).tick(0, rows_s=61.0)
    after = Site(tmp_path, rules)
    # No row came since the restart: that its age is counted from there says nothing.
    for at_s in range(1, 200):
        after.tick(at_s, rows_s=at_s, came=False)
    assert [one["state"] for one in after.trees] == []
    after.tick(201, rows_s=0.1)
    assert [one["state"] for one in after.trees] == ["ended"]


def test_a_silent_source_is_counted_from_its_newest_block(tmp_path):
    rules = AlarmSettings.model_validate({"name": "quiet", "on": "silent", "delay_s": 5.0})
    disk = AlarmSettings.model_validate({"name": "disk", "on": "disk", "limit_percent": 90.0})
    trees = []
    watch = Watch({"p": [rules, disk]}, [], [TARGET], lambda _entry, given: trees.extend(given))
    watch.tick(s(0), {"p": Ages(0.0, 4.9)}, 89.0)
    assert trees == []
    watch.tick(s(1), {"p": Ages(0.0, 5.1)}, 91.0)
    assert [(one["name"], one["state"], one["unit"]) for one in trees] == [
        ("quiet", "firing", "s"),
        ("disk", "firing", "%"),
    ]


def test_the_disk_is_watched_without_any_point(tmp_path):
    disk = AlarmSettings.model_validate({"name": "disk", "on": "disk", "limit_percent": 90.0})
    watch = Watch({"p": [disk]}, [], [TARGET], lambda _entry, _trees: None)
    watch.tick(s(1), {}, 95.0)
    assert [tree["state"] for tree in watch.trees()] == ["firing"]


def test_the_message_of_a_silent_source_names_it_and_since_when():
    rule = AlarmSettings.model_validate({"name": "quiet", "on": "silent", "delay_s": 5.0, "keep_firing_s": 0.0})
    trees = []
    watch = Watch({"p": [rule]}, [], [TARGET], lambda _entry, given: trees.extend(given))

    def text(at_s, age_s, source):
        watch.tick(s(at_s), {"p": Ages(0.0, age_s, source=source)}, None)
        return (watch.trees() or trees[-1:])[0]["text"]

    assert text(10, 5.5, "p.camera") == f"p.camera: no data since {iso(s(4.5))}, for 5.5 s, limit 5 s."
    # It is the one that is silent longest now, and not when the alarm began.
    assert text(30, 22.0, "p.radar") == f"p.radar: no data since {iso(s(8))}, for 22 s, limit 5 s."
    assert text(31, 0.1, "p.camera") == "p.radar: no data: ended. Peak 22 s."


def test_a_silence_is_listed_and_ended_without_an_open_alarm(site):
    site.move(25, 0)
    site.watch.silence(site.id, "anna", s(3600), "gauge is loose", s(1))
    site.move(0, 1)
    assert site.watch.trees() == []
    (one,) = site.watch.silences()
    assert {key: one[key] for key in ("point", "name", "no_data", "owner", "reason")} == {
        "point": "p", "name": "a", "no_data": False, "owner": "anna", "reason": "gauge is loose",
    }  # fmt: skip
    with pytest.raises(MidspanError, match="is not a silence"):
        site.watch.end_silence("none", "bert", s(2))
    site.watch.end_silence(one["id"], "bert", s(2))
    assert site.watch.silences() == []
    assert [(line.what, line.who) for line in site.book.audit(1)] == [("silence ended", "bert")]
    assert "silence:p/a" not in site.book.kept()


def test_rows_that_are_lost_say_nothing_of_the_displacement(site):
    site.move(1e6, 0, status=Status.LOST)
    assert site.trees == []


def test_a_test_goes_to_everybody(site):
    text = site.watch.test("anna", "river bridge", s(0))
    assert TARGET in text
    assert "mqtt" in text
    assert site.reported() == ["test"]
    assert site.book.audit(1)[0].who == "anna"


def test_nothing_is_done_to_an_alarm_that_is_not_open(site):
    for work in (site.watch.acknowledge, site.watch.unsilence):
        with pytest.raises(MidspanError, match="is not an open alarm"):
            work("none", "anna", s(0))


def test_an_alarm_is_what_the_interface_says(site):
    site.move(25, 0)
    (tree,) = site.watch.trees()
    assert tree["since"] == "2026-09-21T14:13:20.000Z"
    assert (tree["value"], tree["peak"], tree["limit"], tree["unit"]) == (25.0, 25.0, 20.0, "mm")
    assert "25 mm ± 0.2 mm, limit 20 mm" in tree["text"]


def test_other_settings_keep_the_open_alarms_of_rules_that_are_still_there(tmp_path):
    usual = {"on": "displacement", "keep_firing_s": 0.0}
    site = Site(tmp_path, [{"name": name, "limit_mm": 20.0, **usual} for name in ("same", "other", "gone")])
    site.move(25, 0)
    before = {tree["name"]: tree["id"] for tree in site.watch.trees()}
    assert len(before) == 3
    rules = [{"name": name, "limit_mm": mm, **usual} for name, mm in (("same", 20.0), ("other", 22.0), ("new", 24.0))]
    settings = [AlarmSettings.model_validate(one) for one in rules]
    site.watch.change({"p": settings, "q": []}, [], [TARGET], s(1.0), mqtt=True)
    now = {tree["name"]: (tree["id"], tree["limit"], tree["state"]) for tree in site.watch.trees()}
    assert now == {"same": (before["same"], 20.0, "firing"), "other": (before["other"], 22.0, "firing")}
    (ended,) = [line for line in site.book.audit(100) if line.what == "ended"]
    assert (ended.alarm, ended.text) == (before["gone"], "is no longer in SITE.toml")
    # Rows that were looked at already are none of the new settings.
    site.move(25, 1)
    names = {tree["name"]: tree["state"] for tree in site.watch.trees()}
    assert names == {"same": "firing", "other": "firing", "new": "firing"}
    site.move(21, 2)
    assert {tree["name"] for tree in site.watch.trees()} == {"same"}


def test_a_delay_goes_on_over_other_settings_of_other_rules(tmp_path):
    slow = {"name": "a", "on": "displacement", "limit_mm": 20.0, "delay_s": 1.5, "keep_firing_s": 0.0, "repeat_s": 60.0}
    site = Site(tmp_path, [slow])
    site.move(25, 0)
    other = {**slow, "name": "b"}
    settings = [AlarmSettings.model_validate(one) for one in (slow, other)]
    site.watch.change({"p": settings}, [], [TARGET], s(1.0), mqtt=True)
    site.move(25, 1)
    assert {tree["name"]: tree["state"] for tree in site.watch.trees()} == {"a": "firing", "b": "pending"}
