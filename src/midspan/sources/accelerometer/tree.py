"""Named arrays of a file that keeps them in a tree (HDF5, MATLAB, npz): to channels with unit and rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sources.accelerometer.channel import Channel, ChannelSet, columns, numbers
from midspan.sources.accelerometer.clock import texts_to_ns
from midspan.sources.accelerometer.dialect import named_unit

_RATES = (
    "rate_hz",
    "sampling_rate",
    "sampling_rate_hz",
    "sample_rate",
    "samplerate",
    "sampling_frequency",
    "fs",
    "rate",
)
_STEPS = ("dt", "delta_t", "sample_interval", "sampling_interval", "wf_increment")
_UNITS = ("unit", "units")


@dataclass(frozen=True, slots=True)
class Leaf:
    """An array of the tree under its full path, with its attributes, then those of the groups around it."""

    name: str
    values: NDArray[np.generic]
    attributes: tuple[dict[str, Any], ...] = ()


def channels_of(leaves: Sequence[Leaf]) -> ChannelSet:
    """Channels of the leaves: columns of arrays (n, k) become `name_1` … `name_k`, single numbers may give the rate.

    Arrays of more than two axes, complex numbers and words are left out and told in the notes.
    """
    file_rate = _rate(
        {leaf.name.replace(".", "/").split("/")[-1]: leaf.values for leaf in leaves if leaf.values.size == 1}
    )
    channels: list[Channel] = []
    notes: list[str] = []
    for leaf in leaves:
        if leaf.values.size < 2:
            continue
        found, said = _channels(leaf, file_rate)
        channels += found
        notes += said
    return ChannelSet(tuple(channels), tuple(notes))


def _channels(leaf: Leaf, file_rate: float | None) -> tuple[list[Channel], list[str]]:
    own_unit = next((_text(level[key]) for level in leaf.attributes for key in _UNITS if key in level), None)
    rate_hz = next((rate for level in leaf.attributes if (rate := _rate(level))), file_rate)
    pairs = columns(leaf.name, leaf.values)
    if not pairs:
        return [], [f"{leaf.name} left out: {leaf.values.ndim} axes"]
    channels: list[Channel] = []
    notes: list[str] = []
    for heading, values in pairs:
        name, heading_unit = named_unit(heading)
        channel, said = _channel(name, values, own_unit or heading_unit)
        notes += said
        if channel:
            start_ns = channel.start_ns
            channels.append(Channel(channel.name, channel.values, channel.unit, rate_hz, start_ns))
    return channels, notes


def _channel(name: str, values: NDArray[np.generic], unit: str | None) -> tuple[Channel | None, list[str]]:
    if values.dtype.kind in "SUO":
        if texts_to_ns([_text(value) for value in values[:100]]) is None:
            return None, []
        moments = texts_to_ns([_text(value) for value in values])
        return (Channel(name, moments[0], "ns"), list(moments[1])) if moments else (None, [])
    found = numbers(values)
    if found is None:
        return None, [f"{name} left out: its numbers are of type {values.dtype}"]
    return Channel(name, found, "ns" if values.dtype.kind == "M" else unit), []


def _rate(attributes: dict[str, Any]) -> float | None:
    lowered = {key.lower(): value for key, value in attributes.items()}
    for keys, inverse in ((_RATES, False), (_STEPS, True)):
        for key in keys:
            number = _number(lowered.get(key))
            if number is not None and np.isfinite(number) and number > 0:
                return 1.0 / number if inverse else number
    return None


def _number(value: Any) -> float | None:
    try:
        return float(np.asarray(value).reshape(-1)[0])
    except (TypeError, ValueError, IndexError):
        return None


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(-1)[0]
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)
