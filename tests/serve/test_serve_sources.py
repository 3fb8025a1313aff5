"""Sources, and what the engine refuses."""

import time

import pytest

from served import PROFILE


def test_sources_say_how_they_stand(reader):
    (one,) = reader.get("/api/v1/sources").json()
    assert (one["name"], one["reason"], one["stamps"], one["rate_hz"]) == ("p.camera", "", "sender", 20.0)
    keys = ("nominal_rate_hz", "delay_s", "late", "restarts", "clock_offset_s", "clock_offset_std_s", "clock_drift_ppm")
    assert [one[key] for key in keys] == [25.0, 0.2, 3, 1, 0.012, 0.001, None]


def test_a_picture_is_a_jpeg_with_its_time_and_size(reader, engine):
    answer = reader.get("/api/v1/sources/p.camera/picture")
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.content.startswith(b"\xff\xd8")
    assert (answer.headers["x-midspan-width"], answer.headers["x-midspan-height"]) == ("2", "3")
    assert reader.get("/api/v1/sources/p.none/picture").status_code == 404


def test_a_picture_says_what_black_and_white_are_where_they_are_temperatures(reader, engine):
    time.sleep(0.6)  # of the picture that is shared
    assert "x-midspan-unit" not in reader.get("/api/v1/sources/p.camera/picture").headers
    engine.shown = {"low": -3.25, "high": 18.5, "unit": "degC"}
    try:
        time.sleep(0.6)
        headers = reader.get("/api/v1/sources/p.camera/picture").headers
    finally:
        engine.shown = {"low": None, "high": None, "unit": ""}
    assert [headers[f"x-midspan-{name}"] for name in ("low", "high", "unit")] == ["-3.25", "18.5", "degC"]


def test_a_radar_shows_its_range_profile_with_its_targets(reader):
    found = reader.get("/api/v1/sources/p.camera/profile").json()
    assert found == PROFILE
    assert reader.get("/api/v1/sources/p.none/profile").status_code == 404


def test_a_source_is_paused_with_a_reason(operator, engine):
    wanted = {"reason": "camera <b>taken</b> down"}
    assert operator.post("/api/v1/sources/p.camera/pause", json=wanted).status_code == 200
    assert engine.commands[-1] == {"command": "pause", "source": "p.camera", **wanted}
    assert operator.post("/api/v1/sources/p.camera/resume").status_code == 200
    for wrong in ({}, {"reason": ""}, {"reason": "x" * 201}, {"reason": "x", "until": "y"}, [], "x"):
        answer = operator.post("/api/v1/sources/p.camera/pause", json=wrong)
        assert answer.status_code == 422, wrong
    assert operator.post("/api/v1/sources/nobody/pause", json={"reason": "x"}).status_code == 404


@pytest.mark.parametrize("path", ["points/p/calibrate", "points/p/calibrations/2/accept"])
def test_what_the_engine_refuses_is_said(operator, engine, path):
    engine.refuse = "p: is already being calibrated or opened; the command is ignored."
    try:
        answer = operator.post(f"/api/v1/{path}")
    finally:
        engine.refuse = ""
    assert answer.status_code == 409
    assert answer.json()["detail"] == "p: is already being calibrated or opened; the command is ignored."
    assert operator.post("/api/v1/points/p/calibrations/77/accept").status_code == 404


def test_too_much_is_not_read(operator, served):
    answer = operator.post("/api/v1/sources/p.camera/pause", content=b'{"reason": "' + b"x" * 1_100_000)
    assert answer.status_code == 413
    chunks = (b"x" * 100_000 for _ in range(20))
    answer = operator.post("/api/v1/sources/p.camera/pause", content=chunks)
    assert answer.status_code == 413
    assert operator.get("/api/v1/points", params={"x": "y" * 5000}).status_code == 414
    assert operator.get("/healthz", headers={"X-Large": "x" * 100_000}).status_code in (400, 431)
