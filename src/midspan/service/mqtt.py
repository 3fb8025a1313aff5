"""The broker: blocks of the sensors in, results, events and states out."""

import itertools
import json
import math
import re
import secrets
import ssl
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from midspan.errors import UsageError
from midspan.records import Event
from midspan.service.packets import Outgoing, Receipt, acknowledgements, publication
from midspan.service.whole_site import WholeSite
from midspan.settings.site import MqttSettings, Shard
from midspan.sources.live.blocks import MAX_BYTES, RESULT, Block, pack
from midspan.store.chunk import Chunk

KEEP_ALIVE_S = 15
# Between two attempts to connect, s: a second in which the broker may have lost nothing yet. Where it refuses the user,
# up to REFUSED_S, as many attempts are what brokers lock out.
AGAIN_S, REFUSED_S = 1, 30
# What the broker keeps for us while we are away, s.
SESSION_S = 3600
# Messages that wait for the broker at most; that the site is there is said besides.
MAX_QUEUED = 10_000
# Messages that the broker may have on their way to us: all that MQTT allows. They are acknowledged once a second, and
# with a broker's own limit (Mosquitto's is 20) no more than that would come in a second.
MAX_UNACKNOWLEDGED = 65_535
# Topics of one packet that subscribes to them.
MAX_SUBSCRIBED = 1000
# The pause before the next attempt where another service with our name ended the connection, s: doubled each time, so
# that the two do not end each other once a second.
NAME_TAKEN_S, MAX_NAME_TAKEN_S = 30, 960
# How many results were dropped is said so often, s.
TELL_AGAIN_S = 60.0
CONNECTIONS = itertools.count(1)


def tls_context(settings: MqttSettings, folder: Path) -> ssl.SSLContext | None:
    """How the broker is trusted, None without TLS; folder: that the certificates' names are relative to.

    Raises UsageError for a certificate or a key that is none.
    """
    if settings.ca is None:
        return None
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.load_verify_locations(folder / settings.ca)
        if settings.cert is not None:
            context.load_cert_chain(folder / settings.cert, None if settings.key is None else folder / settings.key)
    except (OSError, ValueError) as error:
        raise UsageError(
            f"mqtt: ca, cert and key must be matching certificates and key in PEM format; received {settings.ca!r}, "
            f"{settings.cert!r}, {settings.key!r} ({error}). Correct them."
        ) from None
    return context


class Bulk(Protocol):
    """Where messages of topics go that are read together; called from the broker's thread."""

    def put(self, place: int, payload: bytes, receipt: Receipt) -> bool:
        """Queue a message; receipt: what it is acknowledged with later. Whether there was room: it is lost if not."""


class Broker:
    """A connection that is opened again when it is lost.

    taken: called from its thread with topic, payload and a function that acknowledges the message, once what came of it
    is kept; bulk: topics whose messages go elsewhere, with their place there. folder: that the certificates' names are
    relative to. announced: whole topics and what is retained there. max_bytes: of a message. shard: that runs a part
    of the site. Raises UsageError for a certificate that is none.
    """

    def __init__(
        self,
        settings: MqttSettings,
        site: str,
        topics: Mapping[str, int],
        taken: Callable[[str, bytes, Callable[[], None]], None],
        folder: Path = Path(),
        announced: Mapping[str, str] | None = None,
        bulk: Mapping[str, tuple[Bulk, int]] | None = None,
        max_bytes: int = MAX_BYTES,
        shard: Shard | None = None,
    ) -> None:
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        self.connected, self._reason = False, "starting"
        self._settings, self._topics, self._taken = settings, dict(topics), taken
        self._announced, self._bulk = dict(announced or {}), dict(bulk or {})
        # Topics of which nothing is to be retained any more, which the broker does not know yet.
        self._cleared: set[str] = set()
        self.root = f"{settings.prefix}/v1/{site}"
        # Where it says that it is there; of a shard, whose session knows nothing of another number of them, its own.
        place = self.root if shard is None else f"{self.root}/{shard.name}"
        name = f"midspan-{site}" if shard is None else f"midspan-{site}-{shard.name}-of-{shard.count}"
        self._available = f"{place}/available"
        client = _client(settings, name, folder, manual_ack=True)
        self._whole = None
        if shard is not None and shard.number == 1:
            self._whole = WholeSite(_client(settings, f"{name}-site", folder), self.root, shard.count)
        client.will_set(self._available, "offline", qos=1, retain=True)
        client.max_queued_messages_set(0)
        client.reconnect_delay_set(AGAIN_S, AGAIN_S)
        client.on_connect, client.on_disconnect, client.on_message = self._met, self._left, self._came
        client.on_connect_fail = self._not_met
        self._session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        self._session.SessionExpiryInterval = SESSION_S
        self._session.ReceiveMaximum = MAX_UNACKNOWLEDGED
        self._session.MaximumPacketSize = max_bytes
        # Which process holds the site's name is a retained message: brokers do not say who ended a connection.
        self._own, self._holder = secrets.token_hex(8).encode(), f"{place}/service"
        self._connections, self._connected_s, self._pause_s = 0, 0.0, NAME_TAKEN_S
        # Another number for each connection of all brokers of the process, 0 before the first.
        self.connection = 0
        self._client, self._outgoing = client, Outgoing(client)
        # Results that were dropped, up to the last time that this was said, s.
        self._dropped, self._dropped_s = 0, -math.inf

    @property
    def reason(self) -> str:
        """Why the broker is not there, or not for us alone; empty where it is."""
        if self._reason == "name_taken" and self.connected and time.monotonic() - self._connected_s > self._pause_s:
            return ""
        return self._reason

    @property
    def restarts(self) -> int:
        """How often it was connected again."""
        return max(self._connections - 1, 0)

    def start(self) -> None:
        """Connect, now or as soon as the broker is there."""
        self._client.connect_async(
            self._settings.host,
            self._settings.port,
            keepalive=KEEP_ALIVE_S,
            clean_start=False,
            properties=self._session,
        )
        self._client.loop_start()
        if self._whole is not None:
            self._whole.start(self._settings.host, self._settings.port, KEEP_ALIVE_S)

    def change(
        self,
        topics: Mapping[str, int],
        announced: Mapping[str, str],
        removed: Collection[str] = (),
        bulk: Mapping[str, tuple[Bulk, int]] | None = None,
    ) -> None:
        """Listen to these topics in place of those before, and retain these announcements. removed: names of points of
        which nothing is to be retained any more.
        """
        old, fresh = self._topics.keys() - topics.keys(), topics.items() - self._topics.items()
        new = dict(announced.items() - self._announced.items())
        self._cleared |= (self._announced.keys() - announced.keys()) | {f"{self.root}/{one}/state" for one in removed}
        self._topics, self._announced, self._bulk = dict(topics), dict(announced), dict(bulk or {})
        if not self.connected:
            # The next connection does the rest.
            return
        if old:
            self._client.unsubscribe(list(old))
        self._subscribe(list(fresh))
        self._retain(new)

    def _subscribe(self, topics: Sequence[tuple[str, int]]) -> None:
        """Listen to topics, in packets that a broker takes."""
        for first in range(0, len(topics), MAX_SUBSCRIBED):
            self._client.subscribe(list(topics[first : first + MAX_SUBSCRIBED]))

    def _retain(self, announced: Mapping[str, str]) -> None:
        """Retain announcements, and clear what is to be retained no more: with an empty message, as MQTT has it."""
        for topic in self._cleared - self._announced.keys():
            self._client.publish(topic, "", qos=1, retain=True)
        self._cleared.clear()
        for topic, payload in announced.items():
            self._client.publish(topic, payload, qos=1, retain=True)

    def stop(self) -> None:
        """Say that the site is off, and leave."""
        if self._whole is not None:
            self._whole.stop()
        if self.connected:
            said = self._client.publish(self._available, "offline", qos=1, retain=True)
            # Where the connection is lost meanwhile, its last will says it.
            with suppress(RuntimeError, ValueError):
                said.wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()

    def publish(self, topic: str, payload: bytes | str, *, retain: bool = False) -> bool:
        """Send below the site's topic what has to arrive; whether it will. Without a broker it waits, but for what is
        retained, which who connects again sends anew.
        """
        if self._is_full or (retain and not self.connected):
            return False
        if retain:
            self._cleared.discard(f"{self.root}/{topic}")
        self._client.publish(f"{self.root}/{topic}", payload, qos=1, retain=retain)
        return True

    @property
    def _is_full(self) -> bool:
        """Whether as many messages wait as may. The client's own bound would hold for `available` as well."""
        return len(self._client._out_messages) >= MAX_QUEUED

    def publish_results(self, messages: Iterable[tuple[str, bytes]]) -> None:
        """Send messages below the site's topic that may be lost, many in a packet; called in any thread. Without a
        broker none waits, for a slow one as many as `Outgoing` has.
        """
        if self.connected:
            self._outgoing.put(publication(f"{self.root}/{topic}", payload) for topic, payload in messages)

    def dropped_results(self, now_s: float) -> int:
        """How many results were dropped since this last said so, which it does once a minute; 0 without any."""
        dropped = self._outgoing.dropped - self._dropped
        if not dropped or now_s - self._dropped_s < TELL_AGAIN_S:
            return 0
        self._dropped, self._dropped_s = self._dropped + dropped, now_s
        return dropped

    def acknowledge(self, receipts: Sequence[Receipt]) -> None:
        """Acknowledge messages of topics that are read together; those of an earlier connection come again."""
        numbers = [one.number for one in receipts if one.connection == self.connection and one.number]
        if self.connected and numbers:
            self._client._packet_queue(0, acknowledgements(numbers), 0, 0)

    def deliver(self, topic: str, payload: bytes, *, retain: bool, wait_s: float) -> Any:
        """Send below the site's topic; what is returned says by `is_published()` whether the broker has it, for which
        this waits so long. Raises OSError where the broker is away, or takes nothing.
        """
        if not self.connected or self._is_full:
            raise OSError("the broker is away, or too many messages wait for it")
        sent = self._client.publish(f"{self.root}/{topic}", payload, qos=1, retain=retain)
        # Where the connection is lost, the client sends it again on its own.
        with suppress(RuntimeError, ValueError):
            sent.wait_for_publish(wait_s)
        return sent

    def _met(self, client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        if code.is_failure:
            # "Not authorized", "Bad user name or password", "Bad authentication method".
            self._reason = "unauthorized" if re.search("auth|password", str(code).lower()) else "refused"
            client.reconnect_delay_set(AGAIN_S, REFUSED_S)
            return
        client.reconnect_delay_set(AGAIN_S, AGAIN_S)
        self.connected, self._reason, self._connected_s = True, "", time.monotonic()
        self._connections += 1
        self.connection = next(CONNECTIONS)
        self._outgoing.open()
        self._subscribe([(self._holder, 1), *self._topics.items()])
        client.publish(self._holder, self._own, qos=1, retain=True)
        self._retain(self._announced)
        client.publish(self._available, "online", qos=1, retain=True)

    def _not_met(self, _client: Any, _data: Any) -> None:
        # Paho calls this while it handles what went wrong.
        self._reason = "untrusted" if isinstance(sys.exc_info()[1], ssl.SSLError) else "broker_gone"

    def _left(self, _client: Any, _data: Any, _flags: Any, _code: Any, _properties: Any) -> None:
        # A connection that was refused is left too, and why stays.
        if (self.connected and self.reason != "name_taken") or self._reason == "starting":
            self._reason, self._pause_s = "broker_gone", NAME_TAKEN_S
        self.connected = False
        self._outgoing.close()

    def _came(self, client: Any, _data: Any, message: Any) -> None:
        number, qos, topic = message.mid, message.qos, message.topic
        if (place := self._bulk.get(topic)) is not None:
            if not place[0].put(place[1], message.payload, Receipt(self.connection, number if qos else 0)) and qos:
                client.ack(number, qos)
            return
        if topic == self._holder:
            client.ack(number, qos)
            # At the first connection it is a process that ended, most likely our own before a restart.
            if message.retain and message.payload != self._own and self._connections > 1:
                # Another service had the site's name since our last connection: it is given more time with each one.
                client.reconnect_delay_set(self._pause_s, self._pause_s)
                self._reason, self._pause_s = "name_taken", min(2 * self._pause_s, MAX_NAME_TAKEN_S)
            return
        self._taken(topic, bytes(message.payload), lambda: client.ack(number, qos) if qos else None)


def _client(settings: MqttSettings, name: str, folder: Path, *, manual_ack: bool = False) -> Any:
    """A client of a name with the settings of a broker, not connected yet."""
    import paho.mqtt.client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    version = CallbackAPIVersion.VERSION2
    client = mqtt.Client(version, client_id=name, protocol=mqtt.MQTTv5, manual_ack=manual_ack)
    if settings.user is not None:
        secret = settings.password.get_secret_value() if settings.password else None
        client.username_pw_set(settings.user, secret)
    if (context := tls_context(settings, folder)) is not None:
        client.tls_set_context(context)
    return client


def even_parts(rows: Chunk) -> list[Chunk]:
    """Rows in parts whose stamps are even, each within half a step: a block has one interval."""
    steps = np.diff(rows.time_ns)
    usual_ns = float(np.median(steps)) if len(steps) else 0.0
    ends = [0, *(1 + np.flatnonzero(np.abs(steps - usual_ns) > 0.5 * usual_ns)).tolist(), len(rows.time_ns)]
    return [rows.rows(slice(a, b)) for a, b in pairwise(ends)]


def result_payload(rows: Chunk, sequence: int) -> bytes:
    """Rows with even stamps as a block of mm and their standard deviations."""
    time_ns = rows.time_ns
    step_ns = round(int(time_ns[-1] - time_ns[0]) / (len(time_ns) - 1)) if len(time_ns) > 1 else 1
    values = 1e3 * np.asarray(rows.columns["displacement_m"])
    std = 1e3 * np.asarray(rows.columns["std_m"], dtype=np.float64)
    return pack(Block(RESULT, sequence, int(time_ns[0]), max(step_ns, 1), values, std))


def summary(rows: Chunk, status: str) -> str:
    """A second of rows in figures, as JSON, which has null for what is not finite."""
    value = 1e3 * np.asarray(rows.columns["displacement_m"])
    std = 1e3 * np.asarray(rows.columns["std_m"], dtype=np.float64)
    figures = {
        "mean_mm": float(value.mean()),
        "minimum_mm": float(value.min()),
        "maximum_mm": float(value.max()),
        "rms_mm": float(np.sqrt(np.mean(value**2))),
        "std_mm": float(np.median(std)),
    }
    finite = {name: figure if math.isfinite(figure) else None for name, figure in figures.items()}
    time_s = int(rows.time_ns[-1]) / 1e9
    return json.dumps({"time_s": time_s, "rows": len(value), **finite, "status": status, "unit": "mm"})


def event_tree(event: Event) -> dict[str, Any]:
    """An event as it is published and logged."""
    return {"time_s": event.time_ns / 1e9, "kind": event.kind, "text": event.text}
