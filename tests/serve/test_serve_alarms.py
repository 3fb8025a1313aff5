"""Alarms in the interface: what is kept, and what operators do."""

import threading
import time

import pytest
from page import Alarms, swinging

from midspan.alarms.book import Audit, Book, Entry
from midspan.alarms.machine import Alarm
from midspan.alarms.watch import Watch
from midspan.records import NANOSECONDS


@pytest.fixture(scope="module", autouse=True)
def kept(store_folder):
    """A firing alarm of p, and one that ended."""
    now_ns = time.time_ns()
    book = Book(store_folder)
    names = ("p", "deflection", "critical", "displacement", "mm", 20.0)
    for number, state in (("1a", "firing"), ("2b", "ended")):
        one = Alarm(number, f"p/deflection{number}", *names, state, "limit", 25.0, 0.1, 26.0, now_ns, now_ns)
        book.write(Entry([one], [Audit(now_ns, number, state, "", "a line")]))
    book.close()


def test_alarms_are_listed_with_what_the_contract_says(reader):
    found = {one["id"]: one for one in reader.get("/api/v1/alarms").json()}
    assert {"1a", "2b"} <= set(found)
    one = found["1a"]
    assert (one["point"], one["name"], one["state"], one["level"]) == ("p", "deflection", "firing", "critical")
    assert (one["reason"], one["value"], one["limit"], one["unit"]) == ("limit", 25.0, 20.0, "mm")
    assert one["time"].endswith("Z")
    assert [one["id"] for one in reader.get("/api/v1/alarms", params={"state": "ended"}).json()] == ["2b"]
    assert [one["id"] for one in reader.get("/api/v1/alarms", params={"state": "open"}).json()] == ["1a"]
    assert reader.get("/api/v1/alarms/limits").json() == []
    assert reader.get("/api/v1/alarms", params={"point": "q"}).json() == []
    assert reader.get("/api/v1/alarms", params={"state": "loud"}).status_code == 422
    assert [one["what"] for one in reader.get("/api/v1/alarms/audit", params={"alarm": "2b"}).json()] == ["ended"]


def test_an_operator_acknowledges_and_silences(operator, reader, engine):
    assert operator.post("/api/v1/alarms/1a/acknowledge").status_code == 200
    assert engine.commands[-1] == {"command": "acknowledge", "alarm": "1a", "who": "operate"}
    until_s = time.time() + 3600
    wanted = {"until": str(int(until_s) * NANOSECONDS), "reason": "gauge is loose"}
    assert operator.post("/api/v1/alarms/1a/silence", json=wanted).status_code == 200
    assert engine.commands[-1]["until_ns"] == int(until_s) * NANOSECONDS
    assert engine.commands[-1]["who"] == "operate"
    assert operator.post("/api/v1/alarms/1a/unsilence").status_code == 200
    assert operator.post("/api/v1/alarms/test").status_code == 200
    for path in ("1a/acknowledge", "1a/silence", "test"):
        assert reader.post(f"/api/v1/alarms/{path}", json=wanted).status_code == 403


def test_a_silence_without_an_open_alarm_is_listed_and_ended(operator, reader, engine):
    silence = {"id": "5e", "point": "p", "name": "deflection", "no_data": False, "until": "2199-01-01T00:00:00.000Z",
               "owner": "anna", "reason": "gauge is loose"}  # fmt: skip
    assert reader.get("/api/v1/alarms/silences").json() == []
    engine.answers["alarms"] = lambda _: {"alarms": [], "targets": [], "limits": [], "silences": [silence]}
    try:
        assert reader.get("/api/v1/alarms/silences").json() == [silence]
        assert reader.delete("/api/v1/alarms/silences/5e").status_code == 403
        assert operator.delete("/api/v1/alarms/silences/none").status_code == 404
        assert operator.delete("/api/v1/alarms/silences/5e").status_code == 200
    finally:
        del engine.answers["alarms"]
    assert engine.commands[-1] == {"command": "end_silence", "silence": "5e", "who": "operate"}


def test_what_cannot_be_is_said(operator):
    later = "2199-01-01T00:00:00Z"
    assert operator.post("/api/v1/alarms/none/acknowledge").status_code == 404
    assert operator.post("/api/v1/alarms/2b/acknowledge").status_code == 409
    for wrong in ({}, {"until": later}, {"until": "2020-01-01T00:00:00Z", "reason": "x"}, {"until": "x", "reason": "x"},
                  {"until": later, "reason": ""}, {"until": later, "reason": "x", "who": "y"}):  # fmt: skip
        assert operator.post("/api/v1/alarms/1a/silence", json=wrong).status_code == 422, wrong


def test_of_two_who_acknowledge_at_once_one_is_told(store_folder, engine, served, tokens):
    """The alarm of a watch that fires, as `midspan run` has it."""
    changed = []
    watch = Watch({"p": [Alarms.SETTINGS]}, (), (), lambda entry, trees: changed.extend(trees))
    for k in range(10):
        watch.rows("p", swinging(time.time_ns() + k * NANOSECONDS // 5, "p", 50.0), time.time_ns())
    (one,) = [tree for tree in watch.trees() if tree["state"] == "firing"]
    before = engine.answers
    engine.answers = before | {
        "alarms": lambda _: {"alarms": watch.trees(), "limits": [], "targets": []},
        "acknowledge": lambda head: {"text": watch.acknowledge(head["alarm"], head["who"], time.time_ns())},
    }
    both, answers = threading.Barrier(2), []

    def acknowledge(scope):
        with served.client(tokens[scope]) as client:
            client.get("/healthz")
            both.wait(20.0)
            answers.append(client.post(f"/api/v1/alarms/{one['id']}/acknowledge"))

    try:
        threads = [threading.Thread(target=acknowledge, args=[scope]) for scope in ("operate", "admin")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30.0)
    finally:
        engine.answers = before
    done, refused = sorted(answers, key=lambda one: one.status_code)
    assert (done.status_code, refused.status_code) == (200, 409)
    assert "is acknowledged" in refused.json()["detail"]
    assert len([tree for tree in changed if tree["state"] == "acknowledged"]) == 1
