"""The topic `available` of a site that runs as shards: `online` while all of them are.

A connection has one last will, and each shard's is for the shard's own topic. So the first shard has a second
connection, which listens to those and whose last will is for the site's.
"""

from contextlib import suppress
from typing import Any

AGAIN_S = 1


class WholeSite:
    """client: that is not connected yet; root: of the site's topics; count: of its shards."""

    def __init__(self, client: Any, root: str, count: int) -> None:
        self._client, self._topic = client, f"{root}/available"
        self._shards = {f"{root}/shard-{number}/available": False for number in range(1, count + 1)}
        self._online = False
        client.will_set(self._topic, "offline", qos=1, retain=True)
        client.reconnect_delay_set(AGAIN_S, AGAIN_S)
        client.on_connect, client.on_message = self._met, self._came

    def start(self, host: str, port: int, keepalive: int) -> None:
        """Connect, now or as soon as the broker is there."""
        self._client.connect_async(host, port, keepalive=keepalive)
        self._client.loop_start()

    def stop(self) -> None:
        """Say that the site is not whole, and leave."""
        if self._client.is_connected():
            said = self._client.publish(self._topic, "offline", qos=1, retain=True)
            # Where the connection is lost meanwhile, its last will says it.
            with suppress(RuntimeError, ValueError):
                said.wait_for_publish(2.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _met(self, client: Any, _data: Any, _flags: Any, code: Any, _properties: Any) -> None:
        if code.is_failure:
            return
        self._shards = dict.fromkeys(self._shards, False)
        self._publish(online=False)
        client.subscribe([(topic, 1) for topic in self._shards])

    def _came(self, _client: Any, _data: Any, message: Any) -> None:
        self._shards[message.topic] = message.payload == b"online"
        online = all(self._shards.values())
        if online != self._online:
            self._publish(online=online)

    def _publish(self, *, online: bool) -> None:
        self._online = online
        self._client.publish(self._topic, "online" if online else "offline", qos=1, retain=True)
