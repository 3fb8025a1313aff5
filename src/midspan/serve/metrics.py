"""The text of /metrics (Prometheus)."""

from collections.abc import Iterator
from typing import Any

from midspan._version import __version__
from midspan.engine.point import PointStatus
from midspan.serve.serving import Serving

COUNTS = {
    "records": "Records that came.",
    "faults": "Records that could not be used.",
    "skipped": "Frames skipped because the engine was too slow.",
    "late": "Rejected values and frames: late, out of order or repeated.",
    "restarts": "Number of reconnections to the source.",
}
LABELS = ["point", "source"]


class _Figures:
    """A collector of the newest state."""

    def __init__(self, serving: Serving) -> None:
        self._serving = serving

    def collect(self) -> Iterator[Any]:
        """All figures."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily

        serving, state = self._serving, self._serving.link.state
        yield InfoMetricFamily("midspan_build", "The version.", {"version": __version__})
        ready = serving.standing()["ready"]
        yield GaugeMetricFamily("midspan_ready", "1 where /readyz answers 200.", float(ready))
        silent_s = serving.link.silent_s
        yield GaugeMetricFamily(
            "midspan_engine_age_seconds", "Time since the last message of the engine.", min(silent_s, 1e9)
        )
        yield GaugeMetricFamily("midspan_viewers", "Viewers of live rows.", float(serving.live.viewers))
        yield CounterMetricFamily(
            "midspan_viewers_dropped", "Viewers disconnected because they were too slow.", serving.live.dropped
        )
        if state:
            yield from _of_points(state["points"])
            yield from _of_groups(state.get("groups", []))
            store = state.get("store", {})
            yield GaugeMetricFamily("midspan_store_waiting", "Batches that wait.", float(store.get("waiting", 0)))
            yield CounterMetricFamily("midspan_store_dropped", "Batches that were lost.", store.get("dropped", 0))
            if store.get("written") is not None:
                text = "Bytes that the measuring process has written to disks."
                yield CounterMetricFamily("midspan_written_bytes", text, store["written"])


def _of_points(points: list[dict[str, Any]]) -> Iterator[Any]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    counts: dict[str, Any] = {
        key: CounterMetricFamily(f"midspan_source_{key}", text, labels=LABELS) for key, text in COUNTS.items()
    }
    age = GaugeMetricFamily("midspan_source_age_seconds", "Time since the newest record.", labels=LABELS)
    delay = GaugeMetricFamily(
        "midspan_source_delay_seconds", "Delay of records after their newest time stamp.", labels=LABELS
    )
    of_a_point = f"{', '.join(f'{one.value} {one.name.lower()}' for one in PointStatus)}."
    status = GaugeMetricFamily("midspan_point_status", of_a_point, labels=["point"])
    row_age = GaugeMetricFamily("midspan_point_rows_age_seconds", "Time since the newest row.", labels=["point"])
    sigma = GaugeMetricFamily("midspan_point_std_mm", "Standard deviation of the newest row.", labels=["point"])
    for point in points:
        name = point["point"]
        status.add_metric([name], PointStatus[point["status"].upper()].value)
        for gauge, key in ((row_age, "rows_age_s"), (sigma, "sigma_mm")):
            if point.get(key) is not None:
                gauge.add_metric([name], point[key])
        for source in point["sources"]:
            for key, family in counts.items():
                if source.get(key) is not None:
                    family.add_metric([name, source["source"]], source[key])
            for gauge, key in ((age, "age_s"), (delay, "delay_s")):
                if source.get(key) is not None:
                    gauge.add_metric([name, source["source"]], source[key])
    yield from (status, row_age, sigma, age, delay, *counts.values())


def _of_groups(groups: list[dict[str, Any]]) -> Iterator[Any]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    points = GaugeMetricFamily("midspan_group_points", "Points of a group by status.", labels=["group", "status"])
    wrong = GaugeMetricFamily("midspan_group_wrong", "Points without good rows.", labels=["group", "reason"])
    messages = CounterMetricFamily("midspan_group_messages", "Messages of a group that came.", labels=["group"])
    faults = CounterMetricFamily("midspan_group_faults", "Messages that could not be used.", labels=["group"])
    for one in groups:
        for gauge, key in ((points, "statuses"), (wrong, "reasons")):
            for word, count in one[key].items():
                gauge.add_metric([one["group"], word], count)
        messages.add_metric([one["group"]], one["messages"])
        faults.add_metric([one["group"]], one["faults"])
    yield from (points, wrong, messages, faults)


def figures(serving: Serving) -> str:
    """The text of /metrics: of the site, and of this server's process."""
    from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest

    registry = CollectorRegistry()
    registry.register(_Figures(serving))
    ProcessCollector(registry=registry)
    return str(generate_latest(registry).decode())
