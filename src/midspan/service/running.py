"""How the points of a running site and their sources stand."""

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from midspan.engine.point import PointStatus
from midspan.notices import notice_trees
from midspan.radar.chirp import RadarInfo
from midspan.radar.layout import Layout
from midspan.records import NANOSECONDS, RangeFrame
from midspan.service.camera_process import CameraFeed
from midspan.service.capture import capture_settings
from midspan.service.mqtt import MAX_QUEUED
from midspan.service.pace import AVERAGED, FRESH_INTERVALS, FRESH_S, MAX_FIRST_S, ClockDrift, Pace
from midspan.service.point import LivePoint
from midspan.service.reasons import sentence
from midspan.service.replayed import radar_info
from midspan.settings.kinds import ACCELEROMETER, LIVE
from midspan.settings.live_sources import without_secrets
from midspan.settings.site import PointPlan, Site, captures_of
from midspan.sources.accelerometer.units import SI_UNITS, si_factor
from midspan.sources.live.blocks import SEQUENCES, Block
from midspan.sources.live.radar import live_info
from midspan.sources.radar.ti_config import read_settings

# Blocks that are remembered, so that one that comes again is known: 25 s of ten blocks a second.
RECENT = 256
# A fault that goes on is an event so often, s.
TELL_AGAIN_S = 60.0


# Why there are no rows where a sensor is away: of one that is paused that is no fault.
ABSENT = ("lost", "no_rows", "replay_ended", "silent")


@dataclass(slots=True)
class Stream:
    """How one source stands: its address without secrets, when it was heard last, why it gives nothing, counts."""

    point: str
    sensor: str
    address: str
    heard_s: float | None = None
    # Since when records are expected of it.
    expected_s: float = field(default_factory=time.time)
    reason: str = "starting"
    text: str = ""
    records: int = 0
    faults: int = 0
    skipped: int = 0
    # Why it is left out on purpose; empty where it is not.
    paused: str = ""
    # How a camera's frames are dated, see `StampKind`.
    stamps: str = ""
    interval_s: float = 0.0
    pace: Pace = field(default_factory=Pace)
    drift: ClockDrift = field(default_factory=ClockDrift)
    # How often it was opened again, and whether it failed since it was last.
    restarts: int = 0
    failed: bool = False
    # Whether the reason was an event, and when each code was one last.
    reported: bool = False
    reported_s: dict[str, float] = field(default_factory=dict)
    # Of the newest block, and of those that may come doubled.
    sequence: int | None = None
    end_ns: int = 0
    dt_ns: int = 0
    recent: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=RECENT))
    # Blocks that were lost since that was last an event.
    lost: int = 0

    def standing(self, now_s: float, unseen: str) -> dict[str, Any]:
        """As /readyz and the state show it; unseen: why the engine measures nothing with what comes."""
        reason = self.why(now_s) or unseen
        return {
            "point": self.point,
            "source": self.sensor,
            "reason": reason,
            "text": self.paused or self.text or (sentence(reason) if reason else ""),
            "address": self.address,
            "rate_hz": rounded(self.pace.rate_hz, 3),
            "nominal_rate_hz": rounded(1e9 / self.dt_ns if self.dt_ns else None, 3),
            "delay_s": rounded(self.pace.delay_s, 4),
            "age_s": None if self.heard_s is None else round(now_s - self.heard_s, 3),
            "records": self.records,
            "faults": self.faults,
            "skipped": self.skipped,
            "restarts": self.restarts,
            "stamps": self.stamps,
        }

    def why(self, now_s: float) -> str:
        """Why it brings nothing now, as a code; empty where it does."""
        is_silent = self.heard_s is not None and now_s - self.heard_s > self._fresh_s
        return "paused" if self.paused else self.reason or ("silent" if is_silent else "")

    @property
    def _fresh_s(self) -> float:
        """For how long its newest record is fresh."""
        return max(FRESH_S, FRESH_INTERVALS * self.interval_s)

    def heard(self, now_s: float, newest_ns: int, values: int) -> None:
        """A record came, of this many values, the newest of which has this stamp."""
        self.pace.came(newest_ns, values, round(now_s * NANOSECONDS))
        if self.failed:
            self.failed, self.restarts = False, self.restarts + (self.records > 0)
        if self.heard_s is not None and self.records:
            # An outage counts as much as is still fresh.
            longest_s = self._fresh_s if self.records > 1 else MAX_FIRST_S
            passed_s = min(max(now_s - self.heard_s, 0.0), longest_s)
            self.interval_s += (passed_s - self.interval_s) / min(self.records, AVERAGED)
        self.heard_s, self.records = now_s, self.records + 1

    def resumed(self, now_s: float) -> None:
        """It is used again: what it was before it was paused says nothing now."""
        self.paused, self.reason, self.text, self.heard_s, self.expected_s = "", "starting", "", None, now_s

    def is_new(self, block: Block) -> bool:
        """Whether a block has not come before; those that were lost between it and the newest are counted."""
        if (block.sequence, block.t0_ns) in self.recent:
            self.faults += 1
            return False
        self.recent.append((block.sequence, block.t0_ns))
        last = block.sequence - 1 if self.sequence is None else self.sequence
        ahead = (block.sequence - last) % SEQUENCES
        if ahead > SEQUENCES - len(self.recent):
            # It changed places with others: the engine judges it by its stamps.
            return True
        length_ns = block.dt_ns * len(block.values)
        if 1 < ahead < SEQUENCES // 2 and length_ns:
            # No more than fit into the time without values: a sender that was started again counts from anywhere.
            self.lost += min(ahead - 1, max(round((block.t0_ns - self.end_ns) / length_ns), 0))
        self.sequence, self.end_ns = block.sequence, block.t0_ns + length_ns
        return True

    def lost_to_say(self, now_s: float) -> int:
        """How many blocks were lost since that was last an event; 0 where there is none, or the minute is not over."""
        count = self.lost if self._is_due("lost_records", now_s) else 0
        if count:
            self.lost, self.reported_s["lost_records"] = 0, now_s
        return count

    def refused(self, code: str, text: str, now_s: float) -> bool:
        """Something came that cannot be used; returns whether that is an event: what goes on is one a minute."""
        self.faults += 1
        self.reason, self.text = code, text
        is_event = self._is_due(code, now_s)
        if is_event:
            self.reported, self.reported_s[code] = True, now_s
        return is_event

    def _is_due(self, code: str, now_s: float) -> bool:
        return now_s - self.reported_s.get(code, -TELL_AGAIN_S) >= TELL_AGAIN_S


def rounded(value: float | None, digits: int) -> float | None:
    """A number with this many digits after the point; None for what is not known, or no number."""
    return None if value is None or not math.isfinite(value) else round(value, digits)


@dataclass(slots=True, eq=False)
class Running:
    """One point and its sources in the shell.

    factors: SI units in one unit of each channel's readings; layouts: how the samples of each radar's card are ordered;
    scales: kelvin per count, and at count 0, of each infrared camera; published_ns: stamp of the newest row that the
    broker was given, or that the store had when the point went on. beginning: whether it is being begun while other
    points run; early: takes what came meanwhile, with its sensor; ended: whether no record is taken any more; work:
    the job that is done.
    """

    live: LivePoint
    streams: dict[str, Stream]
    factors: dict[str, float]
    layouts: dict[str, Layout]
    cameras: dict[str, CameraFeed] = field(default_factory=dict)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    scales: dict[str, tuple[float, float]] = field(default_factory=dict)
    # The newest frame of each radar, for people.
    profiles: dict[str, RangeFrame] = field(default_factory=dict)
    results: int = 0
    published_ns: int = 0
    # Stamp of the newest provisional row that viewers were given.
    head_ns: int = 0
    work: asyncio.Task[None] | None = None
    beginning: bool = False
    ended: bool = False
    # As many as the broker's client lets wait, should the store be away that long.
    early: deque[tuple[str, Callable[[], None]]] = field(default_factory=deque)
    # When the job that is done began, and how long the last one of each kind took, s.
    _job_s: float | None = None
    _took_s: dict[str, float] = field(default_factory=dict)
    _pace: Pace = field(default_factory=Pace)
    # Stamp of the newest row, when that was given out, and how many stamps of the acceleration were wrong until then.
    _row_ns: int | None = None
    _row_s: float | None = None
    _disordered: int = 0

    @property
    def name(self) -> str:
        """The point's name."""
        return self.live.name

    def wait(self, sensor: str, take: Callable[[], None]) -> None:
        """Let what came of a sensor wait until the point is begun; the oldest that is dropped for it counts as lost."""
        if len(self.early) == MAX_QUEUED:
            dropped, _ = self.early.popleft()
            self.streams[dropped].lost += 1
        self.early.append((sensor, take))

    @property
    def busy(self) -> bool:
        """Whether a job is done."""
        return self.work is not None and not self.work.done()

    def looked_at(self, now_s: float) -> None:
        """Note when the newest row was given out."""
        newest_ns = self.live.row_health.newest_ns
        if newest_ns != self._row_ns:
            if newest_ns is not None:
                self._pace.came(newest_ns, 1, round(now_s * NANOSECONDS))
            self._row_ns, self._row_s, self._disordered = newest_ns, now_s, self.live.disordered

    @contextmanager
    def timed(self, kind: str) -> Iterator[None]:
        """A job of a kind, for as long as it is done."""
        self._job_s = time.monotonic()
        try:
            yield
            self._took_s[kind] = time.monotonic() - self._job_s
        finally:
            self._job_s = None

    def _stage(self) -> dict[str, Any]:
        """What is prepared, and how long that still takes: a job as long as the last one of its kind."""
        stage, left_s = self.live.stage, None
        if stage == "capturing":
            left_s = self.live.capture_left_s
        elif self.live.job is not None and self._job_s is not None and self.live.job.kind in self._took_s:
            left_s = max(self._took_s[self.live.job.kind] - (time.monotonic() - self._job_s), 0.0)
        return {"stage": stage, "stage_left_s": rounded(left_s, 1), "latency_s": rounded(self._pace.delay_s, 3)}

    def no_rows(self, now_s: float) -> str:
        """Why the point gives no rows now that can be relied on, empty where it does."""
        return self._hindrance or self._ended(now_s)

    @property
    def _hindrance(self) -> str:
        """What the point waits for."""
        live, status = self.live, self.live.status
        if live.opened is None:
            if live.job is None and self._is_replayed:
                return "replay_ended"
            return live.reason or ("opening" if live.number else "calibrating")
        if status is PointStatus.WARMING:
            return "opening"
        return live.held_up or ("lost" if status is PointStatus.LOST else "")

    @property
    def _is_replayed(self) -> bool:
        """Whether all sources are recordings that have been replayed."""
        return all(stream.reason == "replay_ended" for stream in self.streams.values())

    def _ended(self, now_s: float) -> str:
        """Why rows came and come no longer; empty where they do."""
        live = self.live
        fresh_s = FRESH_S + (live.opened.delay_s if live.opened is not None else 0.0)
        if self._row_s is None or now_s - self._row_s <= fresh_s:
            return ""
        if self._is_replayed:
            return "replay_ended"
        if live.disordered > self._disordered:
            return "clock"
        return self.streams[ACCELEROMETER].why(now_s) or "no_rows"

    def status(self, now_s: float) -> str:
        """How the point stands: as its newest row says, and lost once there are none."""
        has_none = self.live.opened is not None and not self._hindrance and self._ended(now_s) not in ("", "clock")
        return "lost" if has_none else self.live.status.name.lower()

    def kind(self, sensor: str) -> str:
        """The kind of one of the point's sensors."""
        return next(kind for name, kind, _ in self.live.plan.recording.streams if name == sensor)

    def standing(self, now_s: float) -> dict[str, Any]:
        """As the topic `state` shows it."""
        return {
            "point": self.name,
            "status": self.status(now_s),
            "reason": self.live.reason or self.no_rows(now_s),
            "calibration": self.live.number,
            **self._rows(now_s),
            "sources": [self._source(name, stream, now_s) for name, stream in self.streams.items()],
        }

    def _source(self, name: str, stream: Stream, now_s: float) -> dict[str, Any]:
        """How a source stands, with what the engine knows of it."""
        found = stream.standing(now_s, self.live.unseen(name))
        unknown: dict[str, float | None] = {
            "late": None,
            "clock_offset_s": None,
            "clock_offset_std_s": None,
            "clock_drift_ppm": None,
        }
        if self.live.opened is None or not self.live.opened.takes(name):
            return {**found, **unknown}
        point = self.live.opened.point
        memory, interval_s = point.merge.memory(name), point.interval_s(name)
        if interval_s > 0.0:
            found["nominal_rate_hz"] = rounded(1.0 / interval_s, 3)
        own: dict[str, float | None] = {**unknown, "late": memory.late + memory.disordered}
        if name != ACCELEROMETER:
            offset_s, std_s = point.clock_offset(name)
            estimated_s = offset_s if math.isfinite(std_s) else None
            set_ns = round(point.clock_set_s(name) * NANOSECONDS)
            stream.drift.look(round(now_s * NANOSECONDS), estimated_s, point, set_ns)
            own |= {"clock_offset_s": rounded(offset_s, 6), "clock_offset_std_s": rounded(std_s, 6)}
            own["clock_drift_ppm"] = rounded(stream.drift.ppm, 2)
        return {**found, **own}

    def ready(self, now_s: float) -> dict[str, Any]:
        """As /readyz shows it: whether there are rows."""
        reason = self.no_rows(now_s)
        if reason in ABSENT and any(stream.paused for stream in self.streams.values()):
            reason = "paused"
        text = sentence(reason) if reason else ""
        own = {"point": self.name, "status": self.status(now_s), "reason": reason, "text": text}
        return {**own, **self._rows(now_s)}

    def state(self, now_s: float, standing: dict[str, Any]) -> dict[str, Any]:
        """As the page's server has it; standing: as the topic `state` shows it. notice: what is prepared or waits while
        there are rows; warnings: of the calibration that the rows are made with.
        """
        notice = standing["reason"]
        return {
            **standing,
            **self.ready(now_s),
            "notice": notice,
            "notice_text": sentence(notice) if notice else "",
            "warnings": notice_trees(() if self.live.opened is None else self.live.opened.warnings),
            **self._stage(),
        }

    def _rows(self, now_s: float) -> dict[str, Any]:
        """The age of the newest row, and its deviation relative to the usual one."""
        health = self.live.row_health
        age_s = None if self._row_s is None or self._row_ns is None else round(now_s - self._row_s, 3)
        deviations = {"sigma_mm": health.std_m, "usual_sigma_mm": health.usual_m}
        known = {name: rounded(1e3 * value, 6) for name, value in deviations.items()}
        return {"rows_age_s": age_s, **known}


def running(plan: PointPlan, captures: Path, site: Path) -> Running:
    """A point that nothing has come for yet; captures: the folder of its captured recordings; site: of the site's file.

    Raises what reading a radar's settings, or a recording that is replayed, does.
    """
    factors, layouts, radars = dict[str, float](), dict[str, Layout](), dict[str, RadarInfo]()
    # In which the settings are, of a recording that is replayed too.
    units = dict[str, float]()
    for name, kind, section in plan.recording.streams:
        row, address = LIVE[kind], plan.sources[name]
        replayed = address.startswith("replay:")
        if quantity := row.quantity:
            sensitivity = getattr(section, "sensitivity", 0.0) or None
            units[name] = si_factor(section.unit or SI_UNITS[quantity], quantity, sensitivity)
            factors[name] = 1.0 if replayed else units[name]
        elif row.brings is RangeFrame and replayed:
            radars[name] = radar_info(str(site / address.removeprefix("replay:")), name)
        elif row.brings is RangeFrame:
            layouts[name] = read_settings(site / plan.configs[name]).layout(site / plan.configs[name], section.iq_order)
            radars[name] = live_info(layouts[name])
    live = LivePoint(plan, capture_settings(plan.recording, units), captures, radars)
    streams = {name: Stream(plan.name, name, without_secrets(at)) for name, at in plan.sources.items()}
    return Running(live, streams, factors, layouts)


def line_of(standing: Mapping[str, Any]) -> str:
    """How points and sources stand, in a line."""
    points, sources = standing["points"], standing["sources"]
    words = [f"{one['point']} {one['status']}" + f" ({one['reason']})" * bool(one["reason"]) for one in points]
    down = [f"{one['point']}/{one['source']}: {one['reason']}".lstrip("/") for one in sources if one["reason"]]
    return "; ".join([*([", ".join(words)] if words else []), *down])


def drafted(site: Site, names: Collection[str]) -> list[Running]:
    """The points of a site that have these names, before anything is begun. Raises what `running` does."""
    folder, captures = site.file.parent, captures_of(site)
    return [running(plan, captures / plan.name, folder) for plan in site.points if plan.name in names]


def sizes_of(points: Collection[Running]) -> dict[str, tuple[int, int]]:
    """Width and height (px) of the pictures that points' cameras give, by address."""
    found = [(one.live.plan.sources[name], shape) for one in points for name, shape in one.sizes.items()]
    return {address: (shape[1], shape[0]) for address, shape in found}
