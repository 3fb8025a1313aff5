"""Commands that come by MQTT: `cmd/calibrate`, and `cmd/accept` with the calibration's number."""

import time
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import Any

from midspan.records import Event
from midspan.service.calibrations import accepted
from midspan.service.reasons import NOT_CALIBRATED
from midspan.service.running import Running

COMMANDS = ("calibrate", "accept")
# Of a command's payload no more bytes are looked at: a calibration's number has fewer.
MAX_WANTED = 20


class TopicCommands:
    """Each is answered at once with an event; those for no point of the site on the topic of the point that is meant.

    points: of the site; tell: takes a point, the kind of an event and its text; publish: takes a name and an event;
    begin: begins work of the loop; in_thread: runs a function with a store of its own; is_grouped: whether a name is
    that of a point of a group.
    """

    def __init__(
        self,
        points: Sequence[Running],
        tell: Callable[[Running, str, str], None],
        publish: Callable[[str, Event], None],
        begin: Callable[[Coroutine[Any, Any, None]], object],
        in_thread: Callable[..., Awaitable[Any]],
        is_grouped: Callable[[str], bool],
    ) -> None:
        self._points, self._tell, self._publish = points, tell, publish
        self._begin, self._in_thread, self._is_grouped = begin, in_thread, is_grouped

    def came(self, topic: str, payload: bytes) -> None:
        """A message that brings no block: the broker's session may bring topics of settings before these, too."""
        name, of_commands, command = ("", "", *topic.split("/"))[-3:]
        if of_commands == "cmd":
            self._run(name, command, payload[:MAX_WANTED].decode("ascii", "replace").strip())

    def _run(self, name: str, command: str, wanted: str) -> None:
        """A command; of `accept` without a number the newest calibration that is offered is meant."""
        one = next((point for point in self._points if point.name == name), None)
        if one is None and self._is_grouped(name):
            self._publish(name, Event(time.time_ns(), "command", f"{name}: {NOT_CALIBRATED}"))
        elif one is None:
            listed = ", ".join(point.name for point in self._points)
            text = f"{name}: is not a point of this site. Points: {listed}."
            self._publish(name, Event(time.time_ns(), "command", text))
        elif command == "calibrate":
            self._tell(one, "command", one.live.calibrate())
        elif command == "accept":
            self._begin(self._accept(one, wanted))
        else:
            self._tell(one, "command", f"{name}: cmd/{command} is not a command. Commands: {', '.join(COMMANDS)}.")

    async def _accept(self, one: Running, wanted: str) -> None:
        number = await self._in_thread(accepted, one.live, wanted)
        if number is None:
            self._tell(one, "command", f"{one.name}: no calibration {wanted} is offered.".replace("  ", " "))
        else:
            one.live.calibrated(number)
