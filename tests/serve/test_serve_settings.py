"""SITE.toml over the interface: checked before it is written, and nobody's change is lost."""

import stat
import threading

import pytest

from served import until

SITE = """name = "site"
[store]
path = "store"
[[point]]
name = "p"
[point.accelerometer]
source = "serial:/dev/a"
unit = "m/s^2"
[point.displacement]
source = "serial:/dev/d"
unit = "mm"
"""
ALARM = '[[point.alarm]]\nname = "high"\non = "displacement"\nlimit_mm = 3.0\n'


@pytest.fixture
def file(store_folder):
    """The site's file."""
    file = store_folder.parent / "SITE.toml"
    file.write_text(SITE)
    file.chmod(0o600)
    return file


def test_settings_are_changed_by_who_knows_what_they_were(admin, file, engine):
    answer = admin.get("/api/v1/settings")
    assert answer.text == SITE
    tag = answer.headers["etag"]
    changed = SITE.replace('name = "site"', 'name = "bridge"')
    done = admin.put("/api/v1/settings", content=changed, headers={"If-Match": tag})
    assert done.status_code == 200, done.text
    assert file.read_text() == changed
    # What only its owner may read stays so.
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert engine.commands[-1] == {"command": "reload"}
    # The second of two operators is not heard, and learns why.
    answer = admin.put("/api/v1/settings", content=SITE, headers={"If-Match": tag})
    assert answer.status_code == 412
    assert answer.headers["etag"] == done.headers["etag"] == admin.get("/api/v1/settings").headers["etag"]
    assert file.read_text() == changed
    assert admin.put("/api/v1/settings", content=SITE).status_code == 428


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        (SITE.replace('unit = "mm"', 'unt = "mm"'), "point 'p': displacement.unt", "unit"),
        (SITE + ALARM + 'levl = "critical"\n', "point 'p': alarm 'high': levl", "level"),
        (SITE + ALARM.replace('name = "high"\n', ""), "point 'p': alarm[1]: name", ""),
        (SITE + ALARM.replace("limit_mm = 3.0\n", ""), "point 'p': alarm 'high'", "limit_mm"),
        (SITE.replace('"store"', "7"), "store.path", ""),
        (SITE.replace("[store]", "[store"), None, ""),
        ('[service]\nlisten = "0.0.0.0:80"\n' + SITE[SITE.index("[store]") :], None, ""),
        ("", None, "is empty"),
        (SITE.replace("serial:/dev/a", "{MIDSPAN_NOT_SET}"), None, "MIDSPAN_NOT_SET"),
        (b"\xff\xfe", None, "UTF-8"),
    ],
)
def test_wrong_settings_are_not_written(admin, file, text, key, words):
    tag = admin.get("/api/v1/settings").headers["etag"]
    answer = admin.put("/api/v1/settings", content=text, headers={"If-Match": tag})
    assert answer.status_code == 422
    found = answer.json()
    assert words in found["detail"]
    assert ".SITE-" not in found["detail"]
    if key is not None:
        assert (found["file"], found["key"]) == (str(file), key)
    assert file.read_text() == SITE
    assert list(file.parent.glob(".SITE-*")) == []


def test_other_content_than_text_is_refused(admin, file):
    headers = {"If-Match": "*", "Content-Type": "application/json"}
    assert admin.put("/api/v1/settings", content="{}", headers=headers).status_code == 415


def test_of_two_who_write_at_once_one_is_told(admin, file, served, tokens):
    tag, both, codes = admin.get("/api/v1/settings").headers["etag"], threading.Barrier(2), []

    def write(name):
        with served.client(tokens["admin"]) as client:
            client.get("/healthz")
            both.wait(20.0)
            text = SITE.replace('name = "site"', f'name = "{name}"')
            codes.append(client.put("/api/v1/settings", content=text, headers={"If-Match": tag}).status_code)

    threads = [threading.Thread(target=write, args=[name]) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert sorted(codes) == [200, 412]
    assert file.read_text().count("one") + file.read_text().count("two") == 1


CAMERA = SITE.replace("[point.displacement]", "[point.camera]").replace('"serial:/dev/d"', '"rtsp://camera/x"')
CAMERA = CAMERA.replace('unit = "mm"', "roi = {}")
TARGETS = CAMERA.replace("roi = {}", '[[point.camera.target]]\nname = "a"\nroi = {}')


@pytest.mark.parametrize(("text", "key"), [(CAMERA, "roi"), (TARGETS, "target[1].roi")])
def test_a_region_beyond_the_picture_is_not_written(admin, file, engine, text, key):
    """Of a camera that somebody looked at: its size is known."""
    before = engine.picture
    try:
        engine.picture = b"\xff\xd8jpeg", 320, 240
        until(lambda: admin.get("/api/v1/sources/p.camera/picture").headers["x-midspan-width"] == "320")
        for roi in ("[300, 100, 64, 48]", "[10, 200, 64, 48]", "[0, 0, 321, 240]"):
            answer = admin.put("/api/v1/settings", content=text.format(roi), headers={"If-Match": "*"})
            assert answer.status_code == 422
            assert answer.json()["key"] == f"point 'p': camera.{key}"
            assert "320 x 240 px" in answer.json()["detail"]
        assert file.read_text() == SITE
        # Another camera has a picture of its own size.
        other = text.format("[300, 100, 64, 48]").replace("rtsp://camera/x", "rtsp://camera/larger")
        answer = admin.put("/api/v1/settings?dry_run=true", content=other, headers={"If-Match": "*"})
        assert answer.status_code == 200, answer.text
        inside = admin.put("/api/v1/settings", content=text.format("[256, 192, 64, 48]"), headers={"If-Match": "*"})
        assert inside.status_code == 200, inside.text
    finally:
        engine.picture = before
        file.write_text(SITE)
        until(lambda: admin.get("/api/v1/sources/p.camera/picture").headers["x-midspan-width"] == "2")
