"""SITE.toml: what it may say, and one clear message for everything else."""

import pytest

from midspan.errors import UsageError
from midspan.settings.live_sources import without_secrets
from midspan.settings.site import is_site, load_site, require_folders

SITE = """
name = "river-bridge"
[store]
path = "store"
[mqtt]
user = "midspan"
password = "{SITE_SECRET}"
[[point]]
name = "quarter-span"
method = "lag"
[point.accelerometer]
source = "mqtt:bridge/acc1"
unit = "g"
[point.camera]
source = "rtsp://user:{SITE_SECRET}@127.0.0.1:8554/cam"
direction = "y"
roi = [10, 20, 64, 64]
"""


def loaded(tmp_path, monkeypatch, text=SITE, secret="hidden"):
    file = tmp_path / "SITE.toml"
    file.write_text(text)
    if secret is None:
        monkeypatch.delenv("SITE_SECRET", raising=False)
    else:
        monkeypatch.setenv("SITE_SECRET", secret)
    return load_site(file)


def test_a_site_as_documented(tmp_path, monkeypatch):
    site = loaded(tmp_path, monkeypatch)
    (point,) = site.points
    assert site.name == "river-bridge"
    assert site.store == str(tmp_path / "store")
    assert site.settings.mqtt.password.get_secret_value() == "hidden"
    assert site.settings.mqtt.port == 1883
    assert site.settings.service.listen == "127.0.0.1:8080"
    assert point.sources["camera"] == "rtsp://user:hidden@127.0.0.1:8554/cam"
    assert point.recording.camera.roi == (10, 20, 64, 64)
    assert point.recording.fusion.method == "lag"
    assert is_site(tmp_path / "SITE.toml")
    assert "hidden" not in repr(site.settings)
    assert without_secrets(point.sources["camera"]) == "rtsp://127.0.0.1:8554/cam"


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("rtsp://10.0.0.5:554/cam?user=admin&password=hidden", "rtsp://10.0.0.5:554/cam?…"),
        ("rtsp://10.0.0.5/cam?password=hid@den", "rtsp://…"),
        ("rtsp://user:hid?den@10.0.0.5/cam", "rtsp://…"),
        ("rtsp://10.0.0.5:554/user=admin_password=hidden_channel=1.sdp", "rtsp://10.0.0.5:554/user=…"),
        ("rtsp://user:hid@den@10.0.0.5/cam?channel=1", "rtsp://10.0.0.5/cam?…"),
        ("rtsp://user:hid/den@10.0.0.5/cam", "rtsp://10.0.0.5/cam"),
        ("rtsp://10.0.0.5/cam/1", "rtsp://10.0.0.5/cam/1"),
        ("serial:/dev/a", "serial:/dev/a"),
    ],
)
def test_of_an_address_no_secret_is_shown(address, shown):
    assert without_secrets(address) == shown


def test_a_point_runs_a_method_as_printed(tmp_path, monkeypatch):
    printed = SITE.replace('method = "lag"', 'method = "two-stage-fir"\nliteral = true')
    recording = loaded(tmp_path, monkeypatch, printed).points[0].recording
    assert (recording.fusion.method, recording.fusion.literal) == ("two-stage-fir", True)
    # Trackers and calibration are as printed, too, as by --literal.
    assert recording.calibration.literal


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('method = "lag"', 'method = "lag"\nliteral = true'), r"literal = true needs the method of a paper"),
        (('name = "quarter-span"', 'name = "a b"'), r"point 'a b': name = 'a b': must be 1 to 64 letters"),
        (('method = "lag"', 'method = "smoother"'), r"point 'quarter-span': method = 'smoother'"),
        (('source = "mqtt:bridge/acc1"', 'source = "ftp://x"'), r"accelerometer.source: must be one of mqtt:"),
        (('source = "mqtt:bridge/acc1"', ""), r"accelerometer.source: is missing"),
        (('unit = "g"', 'unit = "g"\nfile = "a.csv"'), r"accelerometer.file: is for files only"),
        (('unit = "g"', 'unit = "g"\ncross_values = ["ax"]'), r"accelerometer.cross_values: is for files only"),
        (('direction = "y"', 'direktion = "y"'), r"camera.direktion: is not a known key"),
        (('path = "store"', ""), r"must have either path \(a folder\) or url"),
        (('"river-bridge"', '"river/bridge"'), r"name = 'river/bridge': must be 1 to 64 characters other than"),
        (('"river-bridge"', '"river+"'), r"name = 'river\+': must be 1 to 64 characters"),
        (('"river-bridge"', '"a\\u0007"'), r"must be 1 to 64 characters other than \+, #, / and control"),
        (('"river-bridge"', '""'), r"name = ''"),
        (("[[point]]", "[point]"), r"must be one \[\[point\]\]"),
        (
            ('[mqtt]\nuser = "midspan"\npassword = "{SITE_SECRET}"', ""),
            r"accelerometer.source: is mqtt:…, but \[mqtt\] is missing",
        ),
        (
            ("[point.accelerometer]", "[point.accelerometre]"),
            r"point 'quarter-span': accelerometre: is not a known section. Did you mean 'accelerometer'\? Known: .*"
            r"accelerometer, camera, infrared, radar, displacement",
        ),
        (('name = "quarter-span"\n', ""), r"point\[1\]: name: is missing"),
        (("[[point]]", "[[points]]"), r"is not a known section. Did you mean 'point'\?"),
        (
            ("[store]", "foo = 1\n[store]"),
            r"foo: is not a known key. Known: name, store, mqtt, service, notify, maintenance, point",
        ),
        (
            ('method = "lag"', "calibraton_s = 40"),
            r"calibraton_s: is not a known key. Did you mean 'calibration_s'\? Known: name, method, literal, lag_s",
        ),
        (
            ('unit = "g"', 'unitt = "g"'),
            r"accelerometer.unitt: is not a known key. Did you mean 'unit'\? Known: source, rate_hz, unit, noise_std,",
        ),
        (('direction = "y"', 'direction = "xy"'), r"""accelerometer: must have source_x and source_y, one for each"""),
        (
            ('source = "mqtt:bridge/acc1"', 'source_x = "mqtt:x"'),
            r"""source_x: must have camera.direction = "xy" with""",
        ),
        (('method = "lag"', "lag_s = 0.4"), r"""'quarter-span': must have method = "lag" with lag_s"""),
        (("mqtt:bridge/acc1", "mqtt:bridge/#"), r"accelerometer.source: must be one topic, without the wildcards"),
        (("mqtt:bridge/acc1", "mqtt:+/acc1"), r"accelerometer.source: must be one topic, without the wildcards"),
        (
            ("mqtt:bridge/acc1", "mqtt:midspan/v1/river-bridge/quarter-span/displacement"),
            r"accelerometer.source: must not be a topic of the site's results, midspan/v1/river-bridge/",
        ),
        (("rtsp://user:{SITE_SECRET}@127.0.0.1:8554/cam", "usb:x"), r"camera.source: must be usb: and the number"),
        (('user = "midspan"\n', ""), r"mqtt: must have user with password"),
        (("[mqtt]", '[mqtt]\nhost = "127.0.0.1:1883"'), r"mqtt.host = '127.0.0.1:1883': must be a host without port"),
        (
            ("[mqtt]", '[mqtt]\nhost = "mqtt://broker:1883"'),
            r"must be a host without port; port is another key: host = 'broker', port = 1883",
        ),
        (("[mqtt]", '[mqtt]\nhost = "[::1]:1883"'), r"must be a host without port; .*: host = '::1', port = 1883"),
        (
            ("[mqtt]", '[mqtt]\nhost = "mqtt://broker"'),
            r"mqtt.host = 'mqtt://broker': must be a host without port, such as",
        ),
        (('user = "midspan"', 'user = ""'), r"mqtt.user = ''"),
        (
            ("[mqtt]", '[service]\nlisten = "0.0.0.0:8080"\n[mqtt]'),
            r"service: must be a loopback address such as 127.0.0.1 without .*; received listen = '0.0.0.0:8080'",
        ),
        (("[mqtt]", '[service]\ntls_key = "key.pem"\n[mqtt]'), r"service: must have both tls_cert and tls_key"),
        (
            (
                "[[point]]",
                '[[point]]\nname = "Quarter-Span"\naccelerometer.source = "mqtt:x"\n'
                'displacement.source = "mqtt:y"\n[[point]]',
            ),
            r"point.name: must differ by more than case; received 'Quarter-Span' and 'quarter-span'",
        ),
    ],
)
def test_a_wrong_setting_is_one_message_with_file_key_and_rule(tmp_path, monkeypatch, change, words):
    assert change[0] in SITE
    with pytest.raises(UsageError, match=words) as error:
        loaded(tmp_path, monkeypatch, SITE.replace(*change))
    assert "SITE.toml" in str(error.value)
    assert "hidden" not in str(error.value)


BOTH = SITE.replace('direction = "y"', 'direction = "xy"').replace(
    'source = "mqtt:bridge/acc1"', 'source_x = "mqtt:bridge/x"\nsource_y = "mqtt:bridge/y"'
)


def test_a_point_along_both_axes_is_two_that_share_their_camera(tmp_path, monkeypatch):
    alarm = '[[point.alarm]]\nname = "deflection"\non = "displacement"\nlimit_mm = 20.0\nlevel = "critical"\n'
    down, sideways = loaded(tmp_path, monkeypatch, BOTH + alarm).points
    assert (down.name, down.axis, down.sources["accelerometer"]) == ("quarter-span", "y", "mqtt:bridge/y")
    assert (sideways.name, sideways.axis, sideways.sources["accelerometer"]) == ("quarter-span-x", "x", "mqtt:bridge/x")
    assert down.sources["camera"] == sideways.sources["camera"]
    assert down.recording.camera.roi == sideways.recording.camera.roi == (10, 20, 64, 64)
    assert down.alarms == sideways.alarms
    assert down.recording.accelerometer.unit == sideways.recording.accelerometer.unit == "g"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("roi =", "scale_mm_per_px = 2.0\nroi ="), r"camera.scale_mm_per_px: must have direction"),
        (('\nsource_y = "mqtt:bridge/y"', ""), r"accelerometer: must have source_x and source_y"),
        (("source_x =", 'source = "mqtt:z"\nsource_x ='), r"accelerometer: must have source_x and source_y"),
        (("[point.camera]", '[point.displacement]\nsource = "mqtt:z"\n[point.camera]'), r"must be the only sensor"),
        (
            ("[[point]]", '[[point]]\nname = "quarter-span-x"\naccelerometer.source = "mqtt:p"\n'
             'displacement.source = "mqtt:q"\n[[point]]'),
            r"2 points have the name 'quarter-span-x'. One is the x axis of a point",
        ),
        (('name = "quarter-span"', f'name = "{63 * "q"}"'), r"name: must have at most 62 characters .* received 63"),
    ],
)  # fmt: skip
def test_what_both_axes_need_is_said(tmp_path, monkeypatch, change, words):
    assert change[0] in BOTH
    with pytest.raises(UsageError, match=words):
        loaded(tmp_path, monkeypatch, BOTH.replace(*change, 1))


def test_a_recording_along_both_axes_has_both_accelerations(tmp_path, monkeypatch):
    text = BOTH.replace('source_x = "mqtt:bridge/x"\nsource_y = "mqtt:bridge/y"', 'source = "replay:bridge"')
    # One that is not there yet may have both.
    assert len(loaded(tmp_path, monkeypatch, text).points) == 2
    (tmp_path / "bridge").mkdir()
    (tmp_path / "bridge" / "recording.toml").write_text('[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\n')
    with pytest.raises(UsageError, match=r"must be a recording with accelerometer.value_x and value_y"):
        loaded(tmp_path, monkeypatch, text)


def test_a_certificate_that_is_missing_is_named_with_its_key(tmp_path, monkeypatch):
    text = SITE.replace("[mqtt]", '[service]\nlisten = "0.0.0.0:443"\ntls_cert = "c.pem"\ntls_key = "k.pem"\n[mqtt]')
    (tmp_path / "c.pem").touch()
    with pytest.raises(UsageError, match=r"service.tls_key = 'k.pem': must be a readable file"):
        require_folders(loaded(tmp_path, monkeypatch, text))


def test_a_name_of_a_site_may_hold_blanks(tmp_path, monkeypatch):
    site = loaded(tmp_path, monkeypatch, SITE.replace('"river-bridge"', '"river bridge, süd"'))
    assert site.name == "river bridge, süd"


def test_a_site_without_points_is_reported_so(tmp_path, monkeypatch):
    with pytest.raises(UsageError, match=r"SITE.toml: point: is missing. Add one \[\[point\]\]"):
        loaded(tmp_path, monkeypatch, SITE[: SITE.index("[[point]]")])
    assert is_site(tmp_path / "SITE.toml")
    (tmp_path / "recording.toml").write_text('[accelerometer]\nfile = "a.csv"\n')
    assert not is_site(tmp_path / "recording.toml")


def test_two_points_of_one_name_are_refused(tmp_path, monkeypatch):
    point = SITE[SITE.index("[[point]]") :]
    with pytest.raises(UsageError, match="2 points have the name 'quarter-span'"):
        loaded(tmp_path, monkeypatch, SITE + point)


def test_a_missing_secret_is_named(tmp_path, monkeypatch):
    with pytest.raises(UsageError, match=r"mqtt.password: \{SITE_SECRET\} needs .* is not set"):
        loaded(tmp_path, monkeypatch, secret=None)
    with pytest.raises(UsageError, match=r"mqtt.password: \{SITE_SECRET\} needs .* is empty"):
        loaded(tmp_path, monkeypatch, secret="")
    with pytest.raises(UsageError, match=r"point 'quarter-span'.camera.source: \{NONE_SUCH\} needs the environment"):
        loaded(tmp_path, monkeypatch, SITE.replace("user:{SITE_SECRET}", "user:{NONE_SUCH}"))


def test_the_folder_of_a_site_is_the_site(tmp_path, monkeypatch):
    loaded(tmp_path, monkeypatch)
    assert is_site(tmp_path)
    assert load_site(tmp_path).file == tmp_path / "SITE.toml"
    (tmp_path / "SITE.toml").write_text("")
    assert is_site(tmp_path)
    with pytest.raises(UsageError, match=r"SITE.toml: is empty"):
        load_site(tmp_path)
    (tmp_path / "recording.toml").write_text("")
    assert not is_site(tmp_path)


@pytest.mark.parametrize("key", ["path", "archive"])
def test_folders_that_cannot_be_made_are_named_with_their_key(tmp_path, monkeypatch, key):
    before = 'path = "store"' if key == "path" else 'path = "store"\narchive = "archive"'
    text = SITE.replace('path = "store"', before)
    site = loaded(tmp_path, monkeypatch, text)
    require_folders(site)
    assert [file.name for file in tmp_path.iterdir()] == ["SITE.toml"]
    named = "store" if key == "path" else "archive"
    (tmp_path / named).mkdir()
    touched_ns = (tmp_path / named).stat().st_mtime_ns
    require_folders(site)
    assert (tmp_path / named).stat().st_mtime_ns == touched_ns
    for place, why in (("SITE.toml", "SITE.toml is a file"), ("SITE.toml/below", "is a file"), ("/proc/x", "/proc: ")):
        site = loaded(tmp_path, monkeypatch, text.replace(f'{key} = "{named}"', f'{key} = "{place}"'))
        with pytest.raises(UsageError, match=rf"SITE.toml: store.{key} = '{place}': must be a writable folder.*{why}"):
            require_folders(site)


def test_a_missing_file_is_no_traceback(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        load_site(tmp_path / "SITE.toml")


ALARM = """
[[point.alarm]]
name = "deflection"
on = "displacement"
span_m = 45.0
span_over = 800
hysteresis_mm = 2.0
no_data_s = 60.0
[[notify]]
webhook = "http://127.0.0.1:9000/{SITE_SECRET}"
secret = "{SITE_SECRET}"
[[notify]]
smtp = "127.0.0.1:25"
to = ["night@example.org"]
[[maintenance]]
begin = 2026-12-01T08:00:00Z
end = 2026-12-01T16:00:00
"""


def test_alarms_as_documented(tmp_path, monkeypatch):
    site = loaded(tmp_path, monkeypatch, SITE + ALARM)
    (alarm,) = site.points[0].alarms
    assert (alarm.limit, alarm.unit, alarm.hysteresis, alarm.level) == (56.25, "mm", 2.0, "warning")
    hook, mail = site.settings.notify
    assert hook.secret.get_secret_value() == "hidden"
    assert mail.to == ("night@example.org",)
    (window,) = site.settings.maintenance
    # 2026-12-01T12:00Z and an hour after the end.
    assert window.covers("quarter-span", 1_796_126_400)
    assert not window.covers("quarter-span", 1_796_144_400)
    assert "hidden" not in repr(site.settings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('on = "displacement"', 'on = "force"'), r"alarm 'deflection': on = 'force': must be"),
        (("span_over = 800\n", ""), r"alarm 'deflection': must have limit_mm, or both span_m and span_over"),
        (("span_m = 45.0\nspan_over = 800\n", ""), r'must have limit_mm with on = "displacement"'),
        (("span_m = 45.0", "limit_mm = 3.0\nspan_m = 45.0"), r"must have limit_mm, or both span_m and span_over"),
        (("span_m = 45.0", "limit_mm_s = 3.0"), r'must have no limit_mm_s and hysteresis_mm_s with on ='),
        (("hysteresis_mm = 2.0", "hysteresis_mm = 60.0"), r"must have a hysteresis below the limit of 56.25 mm"),
        (("hysteresis_mm = 2.0", "histeresis_mm = 2.0"), r"histeresis_mm: is not a known key. Did you mean 'hyst"),
        (('on = "displacement"\nspan_m = 45.0\nspan_over = 800\nhysteresis_mm = 2.0', 'on = "silent"'),
         r'must have delay_s with on = "silent"'),
        (('smtp = "127.0.0.1:25"', 'smtp = "127.0.0.1"'), r"smtp = '127.0.0.1': must be a host and a port"),
        (('to = ["night@example.org"]', ""), r"must have to with smtp"),
        (('to = ["night@example.org"]', 'to = ["night"]'), r"must be an e-mail address"),
        (("http://127.0.0.1", "ftp://127.0.0.1"), r"must have a webhook that begins with http://"),
        (("end = 2026-12-01T16", "end = 2026-12-01T06"), r"must end after it begins"),
        (('name = "deflection"', 'name = "a/b"'), r"must be 1 to 64 characters other than /"),
        (("[[notify]]", '[[point.alarm]]\nname = "deflection"\non = "std"\nlimit_mm = 1.0\n[[notify]]'),
         r"alarm.name: must be unique; 2 alarms have"),
    ],
)  # fmt: skip
def test_wrong_alarms_are_refused_with_the_key(tmp_path, monkeypatch, change, words):
    text = ALARM.replace(*change, 1)
    assert text != ALARM
    with pytest.raises(UsageError, match=words) as caught:
        loaded(tmp_path, monkeypatch, SITE + text)
    assert "hidden" not in str(caught.value)
