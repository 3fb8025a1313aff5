"""Where the records of a live sensor come from: the addresses that `source` takes for each kind of sensor."""

from typing import Any

from midspan.errors import UsageError
from midspan.settings.kinds import ACCELEROMETER
from midspan.sources.live.radar import host_and_port
from midspan.sources.live.serial_line import device_and_baud

ADDRESSES = {
    ACCELEROMETER: ("mqtt:", "serial:", "replay:"),
    "camera": ("rtsp://", "usb:", "replay:"),
    "infrared": ("rtsp://", "usb:", "replay:"),
    "radar": ("udp:", "replay:"),
    "displacement": ("mqtt:", "serial:", "replay:"),
}


def address_of(kind: str, section: dict[str, Any], where: str) -> str:
    """The `source` of a sensor's section; `where` names the section in UsageError."""
    value = section.get("source")
    known = ADDRESSES[kind]
    if not isinstance(value, str) or not value.startswith(known) or value in known:
        listed = ", ".join(f"{one}…" for one in known)
        raise UsageError(f"{where}.source: must be one of {listed}; received {value!r}." if value is not None else
                         f"{where}.source: is missing. Add one of {listed}.")  # fmt: skip
    scheme = next(one for one in known if value.startswith(one))
    try:
        _checked(scheme, value.removeprefix(scheme))
    except ValueError as error:
        raise UsageError(f"{where}.source: {error}; received {without_secrets(value)!r}.") from None
    return value


def _checked(scheme: str, place: str) -> None:
    """ValueError for what cannot follow a scheme."""
    if scheme == "serial:":
        device_and_baud(place)
    elif scheme == "udp:":
        host_and_port(place)
    elif scheme == "usb:" and not (place.isascii() and place.isdecimal()):
        raise ValueError("must be usb: and the number of a camera, as usb:0 for /dev/video0")
    elif scheme == "mqtt:" and any(sign in place for sign in "+#"):
        raise ValueError("must be one topic, without the wildcards + and #; write one source for each topic")


def without_secrets(address: str) -> str:
    """An address without user and password."""
    scheme, at, rest = address.partition("://")
    return f"{scheme}://{rest.rpartition('@')[2]}" if at else address
