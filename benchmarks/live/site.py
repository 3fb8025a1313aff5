"""A site in a folder: its SITE.toml, its process, what it says, and what its store holds."""

import json
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.live.sensors import PERIOD_S, Transmitter
from benchmarks.live.servers import Mosquitto, RtspCamera, command, free_port
from midspan.records import NANOSECONDS, Event
from midspan.service.stored_recording import stored_table
from midspan.simulate.motion.motion import Sines
from midspan.store.store import open_store

HEAD = """
name = "site"
[store]
{store}
[mqtt]
port = {broker}
[service]
listen = "127.0.0.1:{web}"
"""
POINT = """
[[point]]
name = "{name}"
calibration_s = {calibration_s}
{calibration}
[point.accelerometer]
source = "mqtt:acc/{name}"
unit = "m/s^2"
{sensor}
"""
DISPLACEMENT = '[point.displacement]\nsource = "mqtt:dis/{name}"\nunit = "mm"'
CAMERA = '[point.camera]\nsource = "{address}"\ndirection = "y"'


@dataclass
class Held:
    """How a point's rows compare with the truth: share inside the band, worst error in deviations, rms in mm."""

    rows: int
    inside: float
    worst: float
    rms_mm: float


def whole_site(
    stack: ExitStack, folder: Path, motions: Mapping[str, Sines], films: Mapping[str, NDArray[np.uint8]], rate_hz: int
) -> "tuple[RunningSite, Transmitter]":
    """A site that runs, with its broker, its senders and a camera for each film; `stack` ends all but the site."""
    broker, cameras = Mosquitto(folder), {}
    broker.start()
    stack.callback(broker.stop)
    for name, film in films.items():
        camera = RtspCamera(folder, film, rate_hz)
        camera.start()
        stack.callback(camera.stop)
        cameras[name] = camera.address
    sensors = Transmitter(broker.port, dict(motions))
    sensors.start()
    stack.callback(sensors.stop)
    site = RunningSite(folder, broker.port, motions, cameras)
    site.start()
    return site, sensors


class RunningSite:
    """`midspan run` on a folder. cameras: address by the point's name; the other points have a displacement sensor.

    calibrations: files by the point's name; points without one calibrate themselves.
    """

    def __init__(
        self,
        folder: Path,
        broker: int,
        motions: Mapping[str, Sines],
        cameras: Mapping[str, str],
        *,
        store: str = "",
        calibration_s: float = 20.0,
        calibrations: Mapping[str, Path] | None = None,
    ) -> None:
        self.folder, self.motions, self.web, self.broker = folder, dict(motions), free_port(), broker
        self.store = store or str(folder / "store")
        given = f'url = "{store}"' if store else 'path = "store"'
        text = HEAD.format(store=given, broker=broker, web=self.web)
        for name in motions:
            sensor = CAMERA.format(address=cameras[name]) if name in cameras else DISPLACEMENT.format(name=name)
            file = (calibrations or {}).get(name)
            given = f'calibration = "{file}"' if file is not None else ""
            text += POINT.format(name=name, sensor=sensor, calibration_s=calibration_s, calibration=given)
        (folder / "SITE.toml").write_text(text)
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Run it; what it says goes to log.txt."""
        with (self.folder / "log.txt").open("ab") as log:
            self.process = subprocess.Popen(
                command("run", self.folder / "SITE.toml"), cwd=self.folder, stdout=log, stderr=log
            )

    def stop(self, *, kill: bool = False) -> int:
        """End it; returns its exit code."""
        assert self.process is not None
        if kill:
            self.process.kill()
        else:
            self.process.terminate()
        return self.process.wait(timeout=120)

    def standing(self) -> tuple[int, dict[str, Any]]:
        """Status and document of /readyz; 0 while nothing answers."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.web}/readyz", timeout=30) as answer:
                return answer.status, json.loads(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, json.loads(error.read())
        except OSError:
            return 0, {"sources": []}

    def reasons(self) -> dict[str, str]:
        """What is wrong, by POINT/SOURCE; empty where all is well."""
        status, found = self.standing()
        if not status:
            return {"/site": "no answer"}
        return {f"{one['point']}/{one['source']}": one["reason"] for one in found["sources"] if one["reason"]}

    def until(self, condition: Callable[[dict[str, str]], bool], seconds: float) -> float:
        """Wait until what is wrong meets a condition; returns how long that took, s. Raises TimeoutError."""
        begun_s = time.monotonic()
        while (lasted_s := time.monotonic() - begun_s) < seconds:
            if condition(self.reasons()):
                return lasted_s
            time.sleep(0.1)
        raise TimeoutError(f"after {seconds:g} s: {self.reasons()}")

    def rows_s(self, name: str) -> float:
        """How old the newest row of a point in the store is, s; infinite without one."""
        store = open_store(self.store, read_only=True)
        try:
            newest = store.newest_ns(name, "rows")
        finally:
            store.close()
        return float("inf") if newest is None else (time.time_ns() - newest) / NANOSECONDS

    def held(self, name: str, first_ns: int, last_ns: int) -> Held:
        """A point's rows between two instants against the truth, the band's share of the zero taken for common."""
        store = open_store(self.store, read_only=True)
        try:
            table = stored_table(store, name, first_ns, last_ns)
        finally:
            store.close()
        at_s = table.time_ns % round(PERIOD_S * NANOSECONDS) / NANOSECONDS
        error = np.asarray(table.columns["displacement_mm"]) - 1e3 * self.motions[name].displacement(at_s)
        std = np.asarray(table.columns["displacement_std_mm"])
        sharp = std < 2.0 * np.median(std)
        error = error - np.average(error[sharp], weights=std[sharp] ** -2.0)
        inside = float(np.mean(np.abs(error) < 1.96 * std))
        return Held(len(error), inside, float(np.abs(error / std).max()), float(np.sqrt(np.mean(error[sharp] ** 2))))

    def events(self, name: str, first_ns: int = 0) -> list[Event]:
        """What happened at a point since an instant."""
        store = open_store(self.store, read_only=True)
        try:
            return store.events(name, first_ns, 2**62)
        finally:
            store.close()
