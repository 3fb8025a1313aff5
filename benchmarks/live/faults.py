"""What can go wrong on a site, one fault after another: `make faults`, or `python -m benchmarks.live.faults [FAULT …]`.

For each: after how long a reason code or an event says so, whether another point or sensor is blamed, after how long it
is over once the cause is, and whether the rows from the fault's begin to after its end hold the truth.
"""

import contextlib
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.live.sensors import Transmitter, film, motion
from benchmarks.live.servers import Mosquitto, Postgres, RtspCamera
from benchmarks.live.site import Held, RunningSite
from benchmarks.table import goal

NOTICED_S, BACK_S, MIN_INSIDE, WORST = 10.0, 5.0, 0.85, 8.0
LASTING_S, BEFORE_S, AFTER_S = 12.0, 3.0, 10.0
# How long what is due is waited for, s: no figure depends on it, and a busy machine is slow.
PATIENCE_S = 120.0
CAMERA_HZ, SHAPE = 15, (240, 320)
# An event bears the stamp of the record that it follows.
LATENCY_NS = 2_000_000_000
FILMED, WRONG, SOUND = "filmed", "wrong", "sound"


@dataclass
class Rig:
    """Everything of a site that can fail."""

    site: RunningSite
    broker: Mosquitto
    camera: RtspCamera | None
    sensors: Transmitter
    store: Postgres | None


@dataclass(frozen=True)
class Fault:
    """begin and end it; says: the codes or kinds of events of which one is due, at `where` (POINT/SOURCE or a point);
    lasting_s: how long it is left, and longer where nothing says so until then.
    """

    begin: Callable[[Rig], None]
    end: Callable[[Rig], None]
    where: str
    says: tuple[str, ...]
    event: bool = False
    lasting_s: float = LASTING_S


def camera_of(rig: Rig) -> RtspCamera:
    """The camera."""
    assert rig.camera is not None
    return rig.camera


def shown(frames: Callable[[np.ndarray], np.ndarray], path: str = "/cam") -> Callable[[Rig], None]:
    """The camera is started again with what a function makes of its film."""

    def begin(rig: Rig) -> None:
        camera = camera_of(rig)
        camera.stop()
        own = camera.film
        assert own is not None
        camera.film, camera.path = frames(own), path
        camera.start()
        camera.film, camera.path = own, "/cam"

    return begin


def as_before(rig: Rig) -> None:
    """The camera is started again with its own film."""
    camera_of(rig).stop()
    camera_of(rig).start()


def sent(kind: str, **wrong: object) -> tuple[Callable[[Rig], None], Callable[[Rig], None]]:
    """A sensor on MQTT goes wrong, and is right again."""

    def begin(rig: Rig) -> None:
        for name, value in wrong.items():
            setattr(rig.sensors.faults[f"{kind}/{WRONG}"], name, value)

    def end(rig: Rig) -> None:
        for name, value in wrong.items():
            setattr(rig.sensors.faults[f"{kind}/{WRONG}"], name, type(value)(0))  # type: ignore[call-arg]

    return begin, end


def store_of(rig: Rig) -> Postgres:
    """The PostgreSQL server."""
    assert rig.store is not None
    return rig.store


CAMERA, ACCELEROMETER = f"{FILMED}/camera", f"{WRONG}/accelerometer"
FAULTS = {
    "camera off": Fault(
        lambda r: camera_of(r).stop(), lambda r: camera_of(r).start(), CAMERA, ("refused", "stopped", "ended")
    ),
    "camera frozen": Fault(shown(lambda own: own[:1].copy()), as_before, CAMERA, ("frozen",)),
    "camera black": Fault(shown(np.zeros_like), as_before, CAMERA, ("dark",)),
    "camera 404": Fault(shown(lambda own: own, "/other"), as_before, CAMERA, ("not_found",)),
    "camera of another size": Fault(
        shown(lambda own: own[:, : SHAPE[0] // 2].copy()), as_before, CAMERA, ("size_changed",)
    ),
    "broker gone 10 s": Fault(lambda r: r.broker.stop(), lambda r: r.broker.start(), "/mqtt", ("broker_gone",)),
    "accelerometer silent": Fault(*sent("acc", silent=True), ACCELEROMETER, ("silent",)),
    "accelerometer NaN": Fault(*sent("acc", nothing=True), ACCELEROMETER, ("no_values",)),
    "displacement silent": Fault(*sent("dis", silent=True), f"{WRONG}/displacement", ("silent",)),
    "accelerometer of another rate": Fault(*sent("acc", slower=True), WRONG, ("rate",), event=True),
    "blocks lost": Fault(*sent("acc", skipped=5), WRONG, ("lost_records",), event=True),
    "clock +0.3 s": Fault(*sent("acc", clock_s=0.3), WRONG, ("clock", "gap"), event=True),
    "clock -0.3 s": Fault(*sent("acc", clock_s=-0.3), WRONG, ("clock", "backwards", "late"), event=True),
    "database gone": Fault(
        lambda r: store_of(r).stop(), lambda r: store_of(r).start(), "/store", ("store_unavailable",)
    ),
    "broker gone 5 min": Fault(
        lambda r: r.broker.stop(), lambda r: r.broker.start(), "/mqtt", ("broker_gone",), lasting_s=300.0
    ),
}
LONG = ("broker gone 5 min",)


def blamed(reasons: dict[str, str], fault: Fault) -> bool:
    """Whether what is wrong includes the fault's place and one of its codes."""
    return any(where == fault.where and reason in fault.says for where, reason in reasons.items())


def happened(rig: Rig, fault: Fault, since_ns: int) -> bool:
    """Whether one of the fault's events has come."""
    with contextlib.suppress(Exception):
        return any(event.kind in fault.says for event in rig.site.events(fault.where, since_ns - LATENCY_NS))
    return False


def tried(rig: Rig, fault: Fault, after_s: float = AFTER_S) -> tuple[float, set[str], float, dict[str, Held]]:
    """Time to notice, who else was blamed, time to be well again, and how the rows of all points held."""
    rig.site.until(lambda reasons: not reasons, PATIENCE_S)
    time.sleep(BEFORE_S)
    begun_ns, begun_s = time.time_ns(), time.monotonic()
    fault.begin(rig)
    noticed_s, others = np.inf, set()
    while (lasted_s := time.monotonic() - begun_s) < fault.lasting_s or (
        not np.isfinite(noticed_s) and lasted_s < PATIENCE_S
    ):
        reasons = rig.site.reasons()
        now = happened(rig, fault, begun_ns) if fault.event else blamed(reasons, fault)
        if now and not np.isfinite(noticed_s):
            noticed_s = time.monotonic() - begun_s
        point = fault.where.partition("/")[0]
        # Without broker or database all points are concerned.
        others |= {where for where in reasons if point and not where.startswith(point)}
        time.sleep(0.2)
    fault.end(rig)
    ended_s = time.monotonic()
    try:
        rig.site.until(lambda reasons: not reasons, PATIENCE_S)
        back_s = time.monotonic() - ended_s
    except TimeoutError as error:
        print(f"   {error}")
        back_s = np.inf
    time.sleep(after_s)
    first_ns = begun_ns - round(BEFORE_S * 1e9)
    return noticed_s, others, back_s, {name: rig.site.held(name, first_ns, 2**62) for name in rig.site.motions}


def main(wanted: list[str]) -> int:
    """Try the faults that are wanted, or all but the long ones; returns the exit code."""
    if Mosquitto.program() is None or not RtspCamera.is_installed() or Postgres.programs() is None:
        print("Needs mosquitto, PostgreSQL and GStreamer's RTSP server: sh tools/servers.sh.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-faults-") as name, contextlib.ExitStack() as stack:
        rig = built(Path(name), stack)
        rig.site.start()
        stack.callback(rig.site.stop)
        rig.site.until(lambda reasons: not reasons and all_run(rig.site), 180.0)
        print(f"{'fault':30} noticed s  back s  inside, worst in σ of each point")
        for fault_name in wanted or [one for one in FAULTS if one not in LONG]:
            noticed_s, others, back_s, held = tried(rig, FAULTS[fault_name])
            shares = ", ".join(f"{k} {one.inside:.2f} {one.worst:.1f}" for k, one in held.items())
            print(f"{fault_name:30} {noticed_s:9.1f} {back_s:7.1f}  {shares}", flush=True)
            goal(f"{fault_name}: noticed", noticed_s, NOTICED_S, unit="s")
            goal(f"{fault_name}: back", back_s, BACK_S, unit="s")
            goal(f"{fault_name}: others blamed", len(others), 0)
            goal(f"{fault_name}: least inside", min(one.inside for one in held.values()), MIN_INSIDE, at_least=True)
            goal(f"{fault_name}: worst row", max(one.worst for one in held.values()), WORST, unit="σ")
    return 0


def built(folder: Path, stack: contextlib.ExitStack) -> Rig:
    """The site, everything around it running."""
    motions = {name: motion(seed) for seed, name in enumerate((FILMED, WRONG, SOUND))}
    broker, store = Mosquitto(folder), Postgres()
    stack.callback(store.remove)
    camera = RtspCamera(folder, film(motions[FILMED], SHAPE, CAMERA_HZ), CAMERA_HZ)
    for server in (broker, store, camera):
        server.start()
        stack.callback(server.stop)
    sensors = Transmitter(broker.port, motions)
    sensors.start()
    stack.callback(sensors.stop)
    site = RunningSite(folder, broker.port, motions, {FILMED: camera.address}, store=store.database("site"))
    return Rig(site, broker, camera, sensors, store)


def all_run(site: RunningSite) -> bool:
    """Whether every point has rows."""
    with contextlib.suppress(Exception):
        return all(np.isfinite(site.rows_s(name)) for name in site.motions)
    return False


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
