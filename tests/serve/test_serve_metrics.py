"""Figures of the site for Prometheus: counters are counters, and the wear of a card is one of them."""

import json
import os
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("prometheus_client")

from midspan.serve.metrics import figures
from midspan.service.keeping import written_bytes
from served import state


def test_what_the_engine_wrote_is_a_counter(tmp_path):
    before = written_bytes()
    if before is None:
        pytest.skip("the kernel does not count what a process writes")
    with (tmp_path / "file").open("wb") as file:
        file.write(bytes(1 << 20))
        file.flush()
        os.fsync(file.fileno())
    written = written_bytes() - before
    if not written:
        pytest.skip("temporary files are in memory")
    # Another file of the process may be written meanwhile.
    assert 1 << 20 <= written < 2 << 20
    store = {"waiting": 1, "dropped": 2, "written": 3_000_000}
    link = SimpleNamespace(state={"points": [], "store": store}, silent_s=0.0)
    live = SimpleNamespace(viewers=0, dropped=0)
    text = figures(SimpleNamespace(link=link, live=live, standing=lambda: {"ready": True}))
    assert "# TYPE midspan_written_bytes_total counter\nmidspan_written_bytes_total 3e+06" in text
    assert "midspan_store_dropped_total 2.0" in text
    # An engine of a system that does not count says nothing.
    store["written"] = None
    assert "written" not in figures(SimpleNamespace(link=link, live=live, standing=lambda: {"ready": True}))


def test_what_the_dashboard_asks_prometheus_for_is_in_metrics():
    tree = json.loads((Path(__file__).parents[2] / "docs" / "grafana-dashboard.json").read_text())
    asked_for = [one["expr"] for panel in tree["panels"] for one in panel["targets"] if "expr" in one]
    names = {name for text in asked_for for name in re.findall(r"midspan_[a-z_]+", text)}
    link = SimpleNamespace(state=state(), silent_s=0.0)
    live = SimpleNamespace(viewers=0, dropped=0)
    text = figures(SimpleNamespace(link=link, live=live, standing=lambda: {"ready": True}))
    assert names >= {"midspan_ready", "midspan_point_rows_age_seconds"}
    assert [name for name in sorted(names) if not re.search(rf"^{name}[{{ ]", text, re.MULTILINE)] == []
