"""Addresses of live sources: what they may say, and which of them are one and the same source."""

import re
from typing import Any

from midspan.errors import UsageError
from midspan.settings.kinds import LIVE
from midspan.sources.live.radar import host_and_port
from midspan.sources.live.serial_line import device_and_baud


def address_of(kind: str, section: dict[str, Any], where: str) -> str:
    """The `source` of a sensor's section; `where` names the section in UsageError."""
    value = section.get("source")
    known = LIVE[kind].schemes
    if not isinstance(value, str) or not value.startswith(known) or value in known:
        listed = ", ".join(f"{one}…" for one in known)
        raise UsageError(f"{where}.source: must be one of {listed}; received {value!r}." if value is not None else
                         f"{where}.source: is missing. Add one of {listed}.")  # fmt: skip
    scheme = next(one for one in known if value.startswith(one))
    place = value.removeprefix(scheme)
    try:
        if scheme == "serial:":
            device_and_baud(place)
        elif scheme == "udp:":
            host_and_port(place)
        elif scheme == "usb:" and not (place.isascii() and place.isdecimal()):
            raise ValueError("must be usb: and the number of a camera, as usb:0 for /dev/video0")
        elif scheme == "mqtt:" and any(sign in place for sign in "+#"):
            raise ValueError("must be one topic, without the wildcards + and #; write one source for each topic")
    except ValueError as error:
        raise UsageError(f"{where}.source: {error}; received {without_secrets(value)!r}.") from None
    return value


def without_secrets(address: str) -> str:
    """An address without user and password, and without the values that follow its path, as some cameras take both:
    `?user=..&password=..`.
    """
    scheme, at, rest = address.partition("://")
    if not at:
        return address
    # The separator only says that something follows.
    place, values = re.match(r"([^?=]*)([?=].*)?", rest, re.DOTALL).groups()  # type: ignore[union-attr]
    if values and "@" in values:
        # Of a password, or of what comes before the host: nothing says which.
        return f"{scheme}://…"
    return f"{scheme}://{place.rpartition('@')[2]}" + (f"{values[0]}…" if values else "")


def connection(address: str) -> str:
    """What is opened for an address, in one spelling: points whose sources have the same one share it."""
    scheme, _, place = address.partition(":")
    if scheme == "serial":
        device, baud = device_and_baud(place)
        return f"serial:{device}@{baud}"
    if scheme == "udp":
        host, port = host_and_port(place)
        return f"udp:{host}:{port}"
    return f"usb:{int(place)}" if scheme == "usb" else address


def one_use(kind: str, address: str, section: Any) -> tuple[str, str]:
    """Of a line or a radar's port: what can be opened only once, and how a sensor uses it; else empty texts."""
    scheme, _, place = address.partition(":")
    if scheme == "serial":
        device, baud = device_and_baud(place)
        return f"serial:{device}", f"{LIVE[kind].quantity} at {baud} baud"
    if scheme == "udp":
        return connection(address), f"config = {section.config!r}, iq_order = {section.iq_order!r}"
    return "", ""
