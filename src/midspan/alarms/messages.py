"""An alarm as programs and people get it."""

import hashlib
import hmac
import json
from datetime import UTC, datetime
from typing import Any

from midspan.alarms.machine import Alarm
from midspan.alarms.rules import BAND

Tree = dict[str, Any]
NAMES = {
    "displacement": "displacement",
    "drift": "drift of the daily mean",
    "velocity": "velocity",
    "std": "standard deviation",
    "disk": "used part of the store's disk",
    "no_data": "age of the newest row",
}


def iso(time_ns: int) -> str:
    """An instant in ns UTC as ISO 8601, to the millisecond."""
    whole, rest = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}Z"


def sentence_of(alarm: Alarm) -> str:
    """What an alarm says, in a sentence."""
    if alarm.on == "silent":
        source = alarm.source or f"{alarm.point}: a source"
        if alarm.state == "ended":
            return f"{source}: no data: ended. Peak {alarm.peak:.4g} s."
        since_ns = alarm.silent_ns or alarm.since_ns
        return f"{source}: no data since {iso(since_ns)}, for {alarm.value:.4g} s, limit {alarm.limit:.4g} s."
    unit, band = alarm.unit, BAND * alarm.std
    value = f"{alarm.value:.4g} {unit}" + (f" ± {band:.2g} {unit}" if band else "")
    what = f"{alarm.point}: {NAMES[alarm.on]} {value}, limit {alarm.limit:.4g} {unit}"
    if alarm.state == "ended":
        return f"{what}: ended. Peak {alarm.peak:.4g} {unit}."
    if alarm.reason == "band":
        return f"{what}: only the band exceeds the limit."
    if alarm.reason == "no_data":
        return f"{alarm.point}: no rows for {alarm.value:.4g} s, limit {alarm.limit:.4g} s."
    whole = " by the whole band" if band else ""
    if alarm.state == "pending" and abs(alarm.value) - band <= alarm.limit:
        return f"{what}: was exceeded{whole} at {iso(alarm.since_ns)}, for too short a time to fire."
    peak = f" Peak {alarm.peak:.4g} {unit}." if abs(alarm.peak) > abs(alarm.value) else ""
    return f"{what}: exceeded{whole}, since {iso(alarm.since_ns)}.{peak}"


def tree_of(alarm: Alarm, silence: Tree | None = None) -> Tree:
    """An alarm as the interface, MQTT and webhooks have it; silence: who silenced it until when and why."""
    return {
        "id": alarm.id, "point": alarm.point, "name": alarm.name, "state": alarm.state, "level": alarm.level,
        "on": alarm.on, "reason": alarm.reason, "value": round(alarm.value, 6), "value_std": round(alarm.std, 6),
        "peak": round(alarm.peak, 6), "limit": round(alarm.limit, 6), "unit": alarm.unit,
        "time": iso(alarm.time_ns), "since": iso(alarm.since_ns), "text": sentence_of(alarm),
        "acknowledged_by": alarm.who, "silence": silence,
    }  # fmt: skip


def silence_id(key: str) -> str:
    """The id of the silence of a rule, by the rule's key."""
    return hashlib.blake2b(key.encode(), digest_size=8).hexdigest()


def silence_tree(key: str, silence: Tree) -> Tree:
    """A silence as the interface has it; no_data: whether it is that of rows that do not come."""
    point, _, name = key.partition("/")
    is_no_data = name.endswith("/no_data")
    own = {"id": silence_id(key), "point": point, "name": name.removesuffix("/no_data"), "no_data": is_no_data}
    return {**own, **{one: silence[one] for one in ("until", "owner", "reason")}}


def signature(secret: str, body: bytes) -> str:
    """The header X-Midspan-Signature of a body."""
    return "sha256=" + hmac.new(secret.encode(), body, hashlib.sha256).hexdigest()


def body_of(tree: Tree) -> bytes:
    """What is sent."""
    return json.dumps(tree, separators=(",", ":")).encode()


def subject_of(tree: Tree, site: str) -> str:
    """The subject of mail, one line."""
    line = f"[{tree['level']}] {site}, {tree['point']}: {tree['name']} {tree['state']}"
    return " ".join(line.split())


def mail_text(tree: Tree, site: str) -> str:
    """The text of mail."""
    lines = [tree["text"], "", *(f"{key}: {tree[key]}" for key in ("state", "level", "since", "time", "id"))]
    if tree["acknowledged_by"]:
        lines.append(f"acknowledged by: {tree['acknowledged_by']}")
    return "\n".join([*lines, "", f"midspan, {site}", ""])
