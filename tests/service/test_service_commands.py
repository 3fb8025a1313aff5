"""What the page's server asks of points and sources that run."""

import asyncio
import json
import threading

import pytest

from midspan.errors import MidspanError
from midspan.serve.alarms import kept_audit
from midspan.serve.points import refusals
from midspan.service.point import Phase
from midspan.service.run import Service
from midspan.settings.site import load_site
from midspan.store.store import Store, open_store

SITE = """name = "site"
[store]
path = "store"
[[point]]
name = "p"
accept = "manual"
[point.accelerometer]
source = "serial:/dev/none"
[point.displacement]
source = "serial:/dev/nothing"
"""


@pytest.fixture
def service(tmp_path):
    """A service that was not begun, on a store with an offered calibration."""
    (tmp_path / "SITE.toml").write_text(SITE)
    store = open_store(tmp_path / "store")
    store.add_calibration("p", 1, json.dumps({"version": 1}), "{}", accept=False)
    store.close()
    return Service(load_site(tmp_path / "SITE.toml"), lambda _line: None)


def asked(service, command, **values):
    return asyncio.run(service.command({"command": command, **values}))[0]["text"]


def states(tmp_path):
    store = open_store(tmp_path / "store", read_only=True)
    found = [one.state for one in store.calibrations("p")]
    store.close()
    return found


def test_an_offered_calibration_is_refused_and_another_one_is_tried(service, tmp_path):
    live = service._points[0].live
    live.offered(1)
    assert live.phase is Phase.OFFERED
    assert asked(service, "refuse", point="p", number=1) == "p: calibration 1 is refused."
    assert states(tmp_path) == ["refused"]
    assert (live.phase, live.reason) == (Phase.CAPTURING_TO_CALIBRATE, "")
    for command in ("refuse", "accept"):
        with pytest.raises(MidspanError, match="calibration 1 is not offered"):
            asked(service, command, point="p", number=1)


def test_a_refusal_keeps_who_and_why_with_the_event_and_in_the_audit_list(service, tmp_path):
    live = service._points[0].live
    live.offered(1)
    said = asked(service, "refuse", point="p", number=1, who="anna", reason="taken at night")
    assert said == "p: calibration 1 is refused by anna: taken at night"
    service._alarms.open()
    service._alarms.close()
    why = refusals(tmp_path / "store", "p", [1, 2])
    assert {number: (one["owner"], one["reason"]) for number, one in why.items()} == {1: ("anna", "taken at night")}
    (line,) = kept_audit(tmp_path / "store", 10, None)
    assert (line["alarm"], line["what"]) == ("calibration p 1", "calibration refused")


def test_an_offered_calibration_comes_into_force(service, tmp_path):
    service._points[0].live.offered(1)
    assert asked(service, "accept", point="p", number=1) == "p: calibration 1 is in force."
    assert states(tmp_path) == ["in force"]
    assert service._points[0].live.phase is Phase.CAPTURING_TO_OPEN


def test_a_pause_is_no_fault_and_outlasts_a_restart(service, tmp_path):
    reasons = lambda one: {s["source"]: s["reason"] for s in one.state()["points"][0]["sources"]}  # noqa: E731
    assert (
        asked(service, "pause", source="p.displacement", reason="taken down") == "displacement: is paused: taken down"
    )
    again = Service(load_site(tmp_path / "SITE.toml"), lambda _line: None)
    for one in (service, again):
        assert reasons(one) == {"accelerometer": "starting", "displacement": "paused"}
    asked(service, "pause", source="p.accelerometer", reason="taken down")
    # Whatever is left is why the point gives no rows, and that it is being calibrated is one.
    assert {one["reason"] for one in service.state()["sources"]} == {"paused"}
    asked(service, "resume", source="p.displacement")
    assert reasons(service)["displacement"] == "starting"
    with pytest.raises(MidspanError, match="is not paused"):
        asked(service, "resume", source="p.displacement")


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ({"command": "calibrate", "point": "nobody"}, "is not a point"),
        ({"command": "pause", "source": "p", "reason": "x"}, "is not a source"),
        ({"command": "pause", "source": "p.camera", "reason": "x"}, "is not a source"),
        ({"command": "picture", "source": "p.displacement"}, "is not a camera"),
        ({"command": "format", "point": "p"}, "is not a command"),
    ],
)
def test_what_is_not_there_is_said(service, head, words):
    with pytest.raises(MidspanError, match=words):
        asyncio.run(service.command(head))


def test_a_calibration_is_asked_for_once(service):
    assert "records 60 s" in asked(service, "calibrate", point="p")
    service._points[0].live.phase = Phase.CALIBRATING
    service._points[0].live.job = object()
    with pytest.raises(MidspanError, match="is already being calibrated"):
        asked(service, "calibrate", point="p")


def test_of_two_who_decide_at_once_one_is_told(service, monkeypatch):
    """Both see the calibration offered before either of them has decided."""
    service._points[0].live.offered(1)
    both, looked = threading.Barrier(2), Store.calibrations

    def at_once(store, point):
        found = looked(store, point)
        both.wait(20.0)
        return found

    monkeypatch.setattr(Store, "calibrations", at_once)

    async def decide():
        one = {"command": "accept", "point": "p", "number": 1}
        return await asyncio.gather(service.command(one), service.command(one), return_exceptions=True)

    answers = asyncio.run(decide())
    (refused,) = [one for one in answers if isinstance(one, MidspanError)]
    assert "calibration 1 is not offered" in str(refused)
    assert [one[0]["text"] for one in answers if one is not refused] == ["p: calibration 1 is in force."]
