"""/metrics: counts of every source, how the points stand, what waits for the store, as Prometheus text."""

from collections.abc import Iterable

from midspan.service.keeping import Keeper
from midspan.service.running import Running

COUNTS = {
    "records": "Records that came.",
    "faults": "Records that could not be used.",
    "skipped": "Frames that were skipped because the engine did not keep up.",
}


def figures(points: Iterable[Running], keeper: Keeper, now_s: float) -> str:
    """The text of /metrics."""
    from prometheus_client import CollectorRegistry, Gauge, generate_latest

    registry = CollectorRegistry()
    labels = ["point", "source"]
    counts = {key: Gauge(f"midspan_source_{key}", text, labels, registry=registry) for key, text in COUNTS.items()}
    age = Gauge("midspan_source_age_seconds", "Time since the newest record.", labels, registry=registry)
    of_a_point = "0 tracking, 1 coasting, 2 lost, 3 warming, 4 calibrating."
    status = Gauge("midspan_point_status", of_a_point, ["point"], registry=registry)
    for one in points:
        status.labels(one.name).set(int(one.live.status))
        for name, stream in one.streams.items():
            for key, gauge in counts.items():
                gauge.labels(one.name, name).set(getattr(stream, key))
            if stream.heard_s is not None:
                age.labels(one.name, name).set(now_s - stream.heard_s)
    waiting = Gauge("midspan_store_waiting", "Batches that wait for the store.", registry=registry)
    waiting.set(keeper.waiting)
    Gauge("midspan_store_dropped", "Batches that were lost.", registry=registry).set(keeper.dropped)
    return str(generate_latest(registry).decode())
