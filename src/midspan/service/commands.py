"""The commands of the page's server, carried out on the points of a running site."""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from midspan.alarms.book import calibration_id
from midspan.engine.sensors import CameraSensor, RadarSensor
from midspan.errors import MidspanError
from midspan.radar.target import Target
from midspan.records import Floats, RangeFrame
from midspan.service.calibrations import accepted, refused
from midspan.service.camera_process import Picture
from midspan.service.live_socket import Tree
from midspan.service.paused import Paused
from midspan.service.point import LivePoint
from midspan.service.reasons import sentence
from midspan.service.running import Running, Stream
from midspan.sources.thermal.temperatures import celsius_of

# A picture is the next frame: a camera of one frame in five seconds is a slow one.
PICTURE_S = 6.0
# The tracker whose strength is a number of matches; of others it is their quality.
MATCHING = "features"

Answer = tuple[Tree, bytes]


class Commands:
    """points: of the site; paused: which sources are; tell: takes a point, the kind of an event and its text.

    with_store: runs a function with a store of its own in a thread; others: commands of alarms and groups by name;
    table: how the points of a group stand.
    """

    def __init__(
        self,
        points: Sequence[Running],
        paused: Paused,
        tell: Callable[[Running, str, str], None],
        with_store: Callable[..., Awaitable[Any]],
        others: Mapping[str, Callable[[Tree], Tree]] | None = None,
        table: Callable[[Tree], Awaitable[Answer]] | None = None,
    ) -> None:
        self._points, self._paused, self._tell, self._with_store = points, paused, tell, with_store
        self._table: dict[str, Callable[[Tree], Awaitable[Answer]]] = {
            "calibrate": self._calibrate,
            "accept": self._accept,
            "refuse": self._refuse,
            "pause": self._pause,
            "resume": self._resume,
            "picture": self._picture,
            "profile": self._profile,
        }
        if table is not None:
            self._table["group"] = table
        self._others = dict(others or {})

    async def run(self, head: Tree) -> Answer:
        """Carry out one command. Raises MidspanError where that is not possible."""
        name = str(head.get("command"))
        if name in self._others:
            return self._others[name](head), b""
        command = self._table.get(name)
        if command is None:
            listed = ", ".join([*self._table, *self._others])
            raise MidspanError(f"{name}: is not a command. Commands: {listed}.")
        return await command(head)

    async def _calibrate(self, head: Tree) -> Answer:
        one = self._point(head)
        possible, text = one.live.can_calibrate, one.live.calibrate()
        self._tell(one, "command", text)
        if not possible:
            raise MidspanError(text)
        return {"text": text}, b""

    async def _accept(self, head: Tree) -> Answer:
        one, number = self._point(head), int(head["number"])
        if await self._with_store(accepted, one.live, str(number)) is None:
            raise MidspanError(f"{one.name}: calibration {number} is not offered; only an offered one can be accepted.")
        one.live.calibrated(number)
        return {"text": f"{one.name}: calibration {number} is in force."}, b""

    async def _refuse(self, head: Tree) -> Answer:
        one, number = self._point(head), int(head["number"])
        if not await self._with_store(refused, one.live, number):
            raise MidspanError(f"{one.name}: calibration {number} is not offered; only an offered one can be refused.")
        who, reason = str(head.get("who", "")), str(head.get("reason", ""))[:200]
        by, why = f" by {who}" if who else "", f": {reason}" if reason else "."
        text = f"{one.name}: calibration {number} is refused{by}{why}"
        one.live.offer_refused()
        if (note := self._others.get("note")) is not None:
            note({"about": calibration_id(one.name, number), "what": "calibration refused", "who": who, "text": reason})
        self._tell(one, "command", text)
        return {"text": text}, b""

    async def _pause(self, head: Tree) -> Answer:
        one, stream = self._stream(head)
        reason = str(head["reason"])[:200]
        await asyncio.to_thread(self._paused.put, str(head["source"]), reason)
        stream.paused = reason
        text = f"{stream.sensor}: is paused: {reason}"
        self._tell(one, "paused", text)
        return {"text": text}, b""

    async def _resume(self, head: Tree) -> Answer:
        one, stream = self._stream(head)
        if not stream.paused:
            raise MidspanError(f"{head['source']}: is not paused.")
        await asyncio.to_thread(self._paused.put, str(head["source"]), None)
        stream.resumed(time.time())
        text = f"{stream.sensor}: is used again."
        self._tell(one, "resumed", text)
        return {"text": text}, b""

    async def _picture(self, head: Tree) -> Answer:
        one, stream = self._stream(head)
        feed = one.cameras.get(stream.sensor)
        if feed is None:
            raise MidspanError(f"{head['source']}: is not a camera, and only cameras have images.")
        if stream.reason and not stream.paused:
            raise MidspanError(f"{head['source']}: delivers no image. {stream.text or sentence(stream.reason)}")
        loop = asyncio.get_running_loop()
        coming: asyncio.Future[Picture] = loop.create_future()

        def came(picture: Picture) -> None:
            loop.call_soon_threadsafe(lambda: None if coming.done() else coming.set_result(picture))

        feed.camera.ask_picture(came)
        try:
            picture = await asyncio.wait_for(coming, PICTURE_S)
        except TimeoutError:
            raise MidspanError(f"{head['source']}: received no frame within {PICTURE_S:g} s.") from None
        rows, columns = picture.shape
        found = {"time_ns": picture.time_ns, "width": columns, "height": rows, "now_s": time.time()}
        shown = {**shown_range(picture, one.scales.get(stream.sensor)), "targets": tracked(one.live, stream.sensor)}
        return {**found, **shown}, picture.jpeg

    async def _profile(self, head: Tree) -> Answer:
        one, stream = self._stream(head)
        info, frame = one.live.radars.get(stream.sensor), one.profiles.get(stream.sensor)
        if info is None:
            raise MidspanError(f"{head['source']}: is not a radar, and only radars have range profiles.")
        if frame is None:
            raise MidspanError(f"{head['source']}: received no frame yet. {stream.text or sentence('starting')}")
        sensor = None if one.live.opened is None else one.live.opened.point.sensors.get(stream.sensor)
        targets = [followed.target for followed in sensor.chain.targets] if isinstance(sensor, RadarSensor) else []
        return profile_of(frame, info.range_m, targets), b""

    def _point(self, head: Tree) -> Running:
        return next((one for one in self._points if one.name == head.get("point")), None) or _no("point", head)

    def _stream(self, head: Tree) -> tuple[Running, Stream]:
        point, _, sensor = str(head.get("source")).partition(".")
        one = next((one for one in self._points if one.name == point and sensor in one.streams), None)
        return (one, one.streams[sensor]) if one is not None else _no("source", head)


def tracked(live: LivePoint, sensor: str) -> list[Tree]:
    """Where each target of a camera is in the newest frame that was tracked; none before the point is opened.

    roi: its region in the reference frame, px; x_px, y_px: how far it has moved from there, None where it is lost;
    quality: 0 to 1; matches: how many, None of a tracker that counts none.
    """
    opened = live.opened
    found = () if opened is None else opened.journal.newest.get(sensor, ())
    camera = None if opened is None else opened.point.sensors.get(sensor)
    if not isinstance(camera, CameraSensor) or not found:
        return []
    counts = any(name == sensor and own.tracker == MATCHING for name, _, own in live.settings.streams)
    return [
        {
            "name": target.name,
            "roi": list(astuple(target.region)),
            "x_px": _known(one.x_px, 3),
            "y_px": _known(one.y_px, 3),
            "quality": _known(one.quality, 3),
            "matches": round(one.strength) if counts else None,
        }
        for target, one in zip(camera.chain.targets, found, strict=True)
    ]


def _known(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None


def shown_range(picture: Picture, scale: tuple[float, float] | None) -> Tree:
    """What black and white of a picture stand for; scale: kelvin per count and at count 0, None: not known."""
    values, unit = (picture.low, picture.high), "counts" if picture.is_counts else "degC"
    if values[0] is None or values[1] is None:
        return {"low": None, "high": None, "unit": ""}
    if picture.is_counts and scale is not None:
        values, unit = tuple(celsius_of(np.array(values), *scale).tolist()), "degC"
    return {"low": values[0], "high": values[1], "unit": unit}


def profile_of(frame: RangeFrame, range_m: Floats, targets: Sequence[Target]) -> Tree:
    """A radar's frame for people: power (dB of the strongest bin) over range, m, None without one; its targets."""
    # In single precision a weak profile's power, and the least value below, would be 0.
    phasors = frame.phasors[frame.valid].astype(np.complex128)
    power = np.mean(np.abs(phasors) ** 2, axis=0) if frame.valid.any() else np.array([])
    power = np.where(np.isfinite(power), power, 0.0)
    is_known = len(range_m) == len(power) and bool(np.isfinite(range_m).all())
    # Nothing at all is 200 dB below, which no receiver resolves.
    magnitude_db = 10.0 * np.log10(np.maximum(power / max(float(power.max(initial=0.0)), 1e-300), 1e-20))
    return {
        "time_ns": frame.time_ns,
        "range_m": range_m.tolist() if is_known else None,
        "magnitude_db": np.round(magnitude_db, 2).tolist(),
        "targets": [
            {"bin": one.place_bin, "range_m": one.range_m if np.isfinite(one.range_m) else None, "snr_db": one.snr_db}
            for one in targets
        ],
    }


def _no(key: str, head: Tree) -> Any:
    raise MidspanError(f"{head.get(key)}: is not a {key} of this site.")
