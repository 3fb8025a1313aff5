"""SITE.toml over the interface: checked before it is written, and nobody's change is lost."""

import stat

import pytest

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
