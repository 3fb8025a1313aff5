"""The head of a point whose rows come later: the newest row before it is final, for viewers alone."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

import midspan
from midspan.records import NANOSECONDS
from midspan.service.journal import Zero
from midspan.service.live_socket import ROW
from midspan.service.opening import opened
from midspan.service.run import Service
from midspan.settings.site import load_site
from midspan.store.chunk import Chunk
from recording_edits import set_keys

LAG_S = 0.5


@pytest.fixture(scope="module")
def bridge(footbridge, tmp_path_factory):
    """Openings of one recording by `kalman` and by `lag`, to which all its records were given."""
    folder = shutil.copytree(footbridge, tmp_path_factory.mktemp("head") / "recording")
    calibration, found = midspan.calibrate(footbridge), {}
    for method, more in (("kalman", {}), ("lag", {"lag_s": LAG_S})):
        set_keys(folder, "fusion", method=method, **more)
        found[method] = opened(folder, "p", calibration, 1)
    return found


def test_the_head_is_the_row_that_kalman_gives(bridge):
    rows, late = (bridge[method].journal.recent for method in ("kalman", "lag"))
    head = bridge["lag"].journal.provisional(bridge["lag"].point.head)
    assert bridge["kalman"].point.head is None
    assert head.time_ns.tolist() == [rows.time_ns[-1]]
    # Rows come by the lag later, or up to a quarter of it more.
    assert LAG_S <= (head.time_ns[0] - late.time_ns[-1]) / NANOSECONDS <= 1.25 * LAG_S + 0.01
    (kalman,) = [one for one in bridge["kalman"].journal.batch().chunks if one.stream == "rows"]
    for name, values in head.columns.items():
        assert values[0] == kalman.columns[name][-1]


def test_the_head_counts_from_the_zero_in_force(bridge):
    journal, row = bridge["lag"].journal, bridge["lag"].point.head
    before = journal.provisional(row)
    journal.continue_after(0, Zero(1e-3, 0.0))
    moved = journal.provisional(row)
    assert moved.columns["displacement_m"][0] - before.columns["displacement_m"][0] == pytest.approx(1e-3, abs=1e-9)


def test_a_head_is_sent_once_and_never_stored(tmp_path):
    (tmp_path / "SITE.toml").write_text(
        'name = "site"\n[store]\npath = "store"\n[[point]]\nname = "p"\nmethod = "lag"\n'
        '[point.accelerometer]\nsource = "serial:/dev/none"\n[point.displacement]\nsource = "serial:/dev/nothing"\n'
    )
    sent = []
    socket = SimpleNamespace(has_readers=True, publish=lambda head, body=b"": sent.append((head, body)))
    service = Service(load_site(tmp_path / "SITE.toml"), lambda _line: None, None, socket)
    (one,) = service._points
    columns = {"displacement_m": np.array([2e-3]), "std_m": np.array([1e-5]), "status": np.array([2], dtype=np.uint8)}
    one.live = SimpleNamespace(name="p", head=Chunk("p", "rows", np.array([7 * NANOSECONDS]), columns))
    service._publish_head(one)
    service._publish_head(one)
    ((head, body),) = sent
    assert head == {"kind": "head", "point": "p"}
    (row,) = np.frombuffer(body, dtype=ROW)
    assert (row["time_ns"], row["displacement_mm"]) == (7 * NANOSECONDS, 2.0)
    assert row["displacement_std_mm"] == np.float32(1e-2)
    assert not service._keeper.waiting
    # One that is older than a row that viewers have is none.
    one.head_ns, one.published_ns = 0, 8 * NANOSECONDS
    service._publish_head(one)
    assert len(sent) == 1
