"""The part of a site that a shard runs: each N-th place of the file, a port, a store and topics of its own."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from midspan.errors import UsageError
from midspan.service.places import place_of
from midspan.settings.shard import parse_shard, points_in, shard_of, usual_shards
from midspan.settings.site import Shard, load_site

POINT = """
[[point]]
name = "{name}"
[point.accelerometer]
source = "mqtt:{name}/acc"
unit = "m/s^2"
[point.displacement]
source = "mqtt:{name}/gnss"
unit = "mm"
"""
BOTH = """
[[point]]
name = "deck"
[point.accelerometer]
source_x = "mqtt:deck/x"
source_y = "mqtt:deck/y"
unit = "m/s^2"
[point.camera]
source = "usb:0"
direction = "xy"
"""
GROUP = """
[[group]]
name = "{name}"
points = {points}
accelerometer = "mqtt:{name}/{{i}}/acc"
displacement = "mqtt:{name}/{{i}}/gnss"
accelerometer_noise_std = 0.005
displacement_noise_std = 1.5
"""


def site(tmp_path, *points, store='path = "store"', listen="127.0.0.1:8080"):
    file = tmp_path / "SITE.toml"
    head = f'name = "bridge"\n[store]\n{store}\n[mqtt]\nhost = "127.0.0.1"\n[service]\nlisten = "{listen}"\n'
    file.write_text(head + "".join(points))
    return load_site(file)


def names_of(part):
    return [plan.name for plan in part.points] + [plan.point(n) for plan in part.groups for n in plan.numbers]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_each_place_of_the_file_belongs_to_one_shard(tmp_path, count):
    whole = site(
        tmp_path, POINT.format(name="a"), POINT.format(name="b"), GROUP.format(name="n", points=5),
        POINT.format(name="c"), GROUP.format(name="s", points=3),
    )  # fmt: skip
    order = ["a", "b", "c", *(f"n-{k}" for k in range(5)), *(f"s-{k}" for k in range(3))]
    assert points_in(whole) == len(order)
    for number in range(1, count + 1):
        assert names_of(shard_of(whole, Shard(number, count))) == order[number - 1 :: count]


def test_both_axes_of_a_point_stay_together_as_they_share_their_camera(tmp_path):
    whole = site(tmp_path, POINT.format(name="a"), BOTH, POINT.format(name="b"))
    assert names_of(shard_of(whole, Shard(1, 2))) == ["a", "b"]
    assert names_of(shard_of(whole, Shard(2, 2))) == ["deck", "deck-x"]


def test_a_shard_has_a_port_and_a_store_of_its_own(tmp_path):
    whole = site(tmp_path, GROUP.format(name="n", points=9))
    parts = [shard_of(whole, Shard(number, 3)) for number in (1, 2, 3)]
    assert [part.settings.service.listen for part in parts] == [f"127.0.0.1:{port}" for port in (8080, 8081, 8082)]
    assert [part.store for part in parts] == [str(tmp_path / "store" / f"shard-{k}") for k in (1, 2, 3)]
    assert [part.names for part in parts] == [["n 0 3"], ["n 1 3"], ["n 2 3"]]
    assert parts[2].name == whole.name
    any_port = site(tmp_path, GROUP.format(name="n", points=9), listen="127.0.0.1:0")
    assert shard_of(any_port, Shard(2, 3)).settings.service.listen == "127.0.0.1:0"


def test_shards_in_one_database_have_places_of_their_own(tmp_path):
    url = "postgresql://user@host/db"
    whole = site(tmp_path, GROUP.format(name="n", points=9), store=f'url = "{url}?sslmode=require"')
    parts = [shard_of(whole, Shard(number, 2)) for number in (1, 2)]
    assert parts[0].store == f"{url}?sslmode=require&application_name=midspan-shard-1"
    assert len({place_of(one) for one in (whole.store, *(part.store for part in parts))}) == 3
    assert place_of(url) == place_of(whole.store)


def test_wrong_shards_are_refused(tmp_path):
    whole = site(tmp_path, POINT.format(name="a"), GROUP.format(name="n", points=2), listen="127.0.0.1:65534")
    with pytest.raises(UsageError, match="at most as many as the file has points, 3; received 4"):
        shard_of(whole, Shard(1, 4))
    with pytest.raises(UsageError, match="shard 3 would listen on port 65536"):
        shard_of(whole, Shard(3, 3))
    for text in ("0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"):
        with pytest.raises(UsageError, match="must be K/N"):
            parse_shard(text)
    assert parse_shard("2/3") == Shard(2, 3)


@pytest.mark.parametrize(("points", "shards"), [(1, 1), (5000, 1), (5001, 2), (100_000, 20)])
def test_a_fleet_has_a_shard_for_five_thousand_points(tmp_path, points, shards):
    assert usual_shards(site(tmp_path, GROUP.format(name="n", points=points))) == shards


FLEET = Path(__file__).parents[1] / "examples" / "fleet"


def test_systemd_finds_nothing_wrong_with_the_template(tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd is not installed")
    unit = (FLEET / "midspan@.service").read_text()
    unit = unit.replace("/opt/midspan/bin/midspan", sys.executable).replace(" mosquitto.service postgresql.service", "")
    file = tmp_path / "midspan@.service"
    file.write_text(unit)
    instance = tmp_path / "midspan@1.service"
    instance.symlink_to(file)
    done = subprocess.run([analyze, "verify", "--man=no", instance], capture_output=True, text=True, timeout=60)
    assert (done.returncode, [line for line in done.stderr.splitlines() if "midspan@" in line]) == (0, [])


def test_a_pod_runs_the_shard_of_its_number(tmp_path):
    """The shell's line of the StatefulSet, with a midspan that says what it was called with."""
    yaml = pytest.importorskip("yaml")
    _, stateful = yaml.safe_load_all((FLEET / "midspan.yaml").read_text())
    (container,) = stateful["spec"]["template"]["spec"]["containers"]
    shards = {one["name"]: one["value"] for one in container["env"]}["SHARDS"]
    assert int(shards) == stateful["spec"]["replicas"]
    (line,) = container["args"]
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "SITE.toml").touch()
    (tmp_path / "midspan").write_text('#!/bin/sh\necho "$@"\n')
    (tmp_path / "midspan").chmod(0o755)
    line = line.replace("/site/", f"{tmp_path}/site/").replace("/data/store", str(tmp_path))
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "HOSTNAME": "midspan-2", "SHARDS": shards}
    done = subprocess.run([*container["command"], line], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["run", "SITE.toml", "--shard", "3/4"]
    probe = container["livenessProbe"]["exec"]["command"][-1]
    script = f'python() {{ echo "$2"; }}; {probe}'
    shown = subprocess.run(["sh", "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert "http://127.0.0.1:8082/healthz" in shown.stdout
