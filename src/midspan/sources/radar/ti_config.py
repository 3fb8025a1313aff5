"""Settings of TI's mmWave radars: the demo firmware's command file (.cfg) and mmWave Studio's JSON."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.checks import ValueRange, shown
from midspan.errors import DataError, UsageError
from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import Layout
from midspan.sources.boundary import reading
from midspan.trees import TreeError, read_json, read_text

# Lanes of the capture's interface by family of device: on four lanes the receivers are interleaved sample by sample.
_LANES = {"12": 4, "14": 4, "16": 2, "18": 2, "64": 2, "68": 2}
_DEVICE = re.compile(r"\b[xai]wr[-_ ]?(\d{2})(\d{2}|xx)", re.IGNORECASE)
_BITS = {0: 12, 1: 14, 2: 16}
# As the fields of the radar's commands allow, or far beyond what any device can do.
MAX_CHIRPS, MAX_LOOPS = 512, 255
_NUMBER = ValueRange(-1e12, 1e12)
_CHIRP = {
    "start frequency": ValueRange(1.0, 1000.0, "GHz"),
    "idle time": ValueRange(0.0, 1e6, "µs"),
    "ADC start": ValueRange(0.0, 1e6, "µs"),
    "end of the ramp": ValueRange(0.0, 1e6, "µs"),
    "slope": ValueRange(1e-3, 1e4, "MHz/µs"),
    "number of samples": ValueRange(1, 65535),
    "sampling rate": ValueRange(1.0, 1e6, "ksps"),
    "frame period": ValueRange(1e-3, 1e6, "ms"),
}
_STUDIO_DEFAULT, _DEMO_DEFAULT = "IIQQ", "QQII"
_STUDIO_KEYS = (
    *("startFreqConst_GHz", "idleTimeConst_usec", "adcStartTimeConst_usec", "rampEndTime_usec"),
    *("freqSlopeConst_MHz_usec", "numAdcSamples", "digOutSampleRate"),
)


@dataclass(frozen=True, slots=True)
class TiSettings:
    """What a settings file says.

    frames: that were to be recorded, 0 where it is without end; lanes 2 or 4; order: of I and Q as far as the file
    says it (its first letter; the pairing is the capture software's usual one), else the software's default with
    `order_said` False; header: whether each chirp is led by one.
    """

    profile: ChirpProfile
    frames: int
    lanes: int
    order: str
    order_said: bool
    header: bool = False
    notes: tuple[str, ...] = ()

    def layout(self, path: Path, iq_order: str = "auto") -> Layout:
        """How samples with these settings, of the file `path`, are ordered. Raises DataError."""
        if self.header:
            raise DataError(f"{path}: lvdsStreamCfg enableHeader = 1 cannot be read. Capture with 0.")
        try:
            return Layout(self.profile, self.order if iq_order == "auto" else iq_order, self.lanes)
        except UsageError as error:
            raise DataError(f"{path}: {error}") from None


def read_settings(path: Path) -> TiSettings:
    """The settings in a `.cfg` or `.json` file.

    Raises UsageError for another suffix, DataError for what is missing, contradictory or of an unknown device.
    """
    if not path.is_file():
        raise DataError(f"{path}: not found. Correct radar.config; it counts from the settings file's folder.")
    with reading(path, "settings of a TI radar"):
        try:
            if path.suffix.lower() == ".cfg":
                return _demo(path, read_text(path, strict=False))
            if path.suffix.lower() == ".json":
                return _studio(path, read_json(path))
        except TreeError as error:
            raise DataError(f"{path}: {error}.") from None
    raise UsageError(
        f"radar.config must be a .cfg of the mmWave demo or a .json of mmWave Studio; received {path.name}."
    )


def _lanes(path: Path, text: str, interleaved: bool) -> tuple[int, str]:
    """Lanes and the device's name, found in a text; DataError for a device that is not known."""
    found = _DEVICE.search(text)
    if found is None:
        return (4 if interleaved else 2), ""
    if found.group(1) not in _LANES:
        known = ", ".join(f"xWR{family}xx" for family in _LANES)
        raise DataError(
            f"{path} is for {found.group(0)}, whose byte layout is not known; known are {known}. Store the slow-time "
            "I/Q of the target as .h5 or .npy instead."
        )
    return _LANES[found.group(1)], found.group(0)


def _commands(path: Path, text: str) -> dict[str, list[list[float]]]:
    """The numbers of each command of a .cfg, line by line; DataError names file, line and command."""
    commands: dict[str, list[list[float]]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("%")[0].split()
        if not words:
            continue
        try:
            values = [float(word) for word in words[1:]]
        except ValueError:
            values = [np.nan]
        if not all(value in _NUMBER for value in values):
            if words[0] in ("profileCfg", "chirpCfg", "frameCfg", "channelCfg", "adcCfg", "adcbufCfg"):
                raise DataError(
                    f"{path}, line {number}: {words[0]} takes numbers {_NUMBER}; received {shown(words[1:])}."
                )
            values = []
        commands.setdefault(words[0], []).append(values)
    return commands


def _demo(path: Path, text: str) -> TiSettings:
    commands = _commands(path, text)
    if "advFrameCfg" in commands or "subFrameCfg" in commands:
        raise DataError(f"{path} uses advanced frames, whose chirps differ; only frameCfg can be read.")
    for name, least in (("frameCfg", 5), ("channelCfg", 2)):
        if name not in commands:
            raise DataError(f"{path}: the command {name} is missing; without it the frames have no size.")
        if len(commands[name][-1]) < least:
            received = len(commands[name][-1])
            raise DataError(f"{path}: {name} must have {least} numbers or more; received {received}.")
    frame, receivers = commands["frameCfg"][-1], bin(int(commands["channelCfg"][-1][0])).count("1")
    adc = commands.get("adcCfg", [[2.0, 1.0]])[-1]
    # Older firmware has no sub-frame index in front.
    buffer = commands.get("adcbufCfg", [[]])[-1][-4:]
    chirps = [(int(row[0]), int(row[1]), int(row[2]), int(row[7]), row[3:7]) for row in commands.get("chirpCfg", [])]
    used, transmitters = _chirps(path, chirps, (int(frame[0]), int(frame[1])), int(frame[2]))
    row = [row for row in commands.get("profileCfg", []) if row and int(row[0]) == used][-1:]
    if not row or len(row[0]) < 11:
        raise DataError(f"{path}: profileCfg {used}, which the frame uses, is missing or has fewer than 11 numbers.")
    values = (*(row[0][k] for k in (1, 2, 3, 4, 7, 9, 10)), frame[4])
    lanes, device = _lanes(path, text, interleaved=len(buffer) == 4 and buffer[2] == 0 and receivers == 4)
    stream = commands.get("lvdsStreamCfg", [[]])[-1]
    return TiSettings(
        _profile(path, values, (receivers, int(adc[0]), int(adc[1]) if len(adc) > 1 else 1), transmitters),
        frames=int(frame[3]),
        lanes=lanes,
        order="IIQQ" if len(buffer) == 4 and buffer[1] == 0 else _DEMO_DEFAULT,
        order_said=len(buffer) == 4,
        header=len(stream) > 1 and stream[1] == 1,
        notes=() if device else (f"{path.name} names no device; two lanes are assumed.",) if lanes == 2 else (),
    )


def _chirps(
    path: Path, chirps: Sequence[tuple[int, int, int, int, Sequence[float]]], span: tuple[int, int], loops: int
) -> tuple[int, tuple[int, ...]]:
    """The profile that the frame's chirps share, and the transmitters of each chirp of a frame."""
    if not 0 <= span[0] <= span[1] < MAX_CHIRPS or not 1 <= loops <= MAX_LOOPS:
        raise DataError(
            f"{path}: the frame must use chirps from 0 to {MAX_CHIRPS - 1}, from 1 to {MAX_LOOPS} loops of them; "
            f"received chirps {span[0]} to {span[1]}, {loops} loops. Check frameCfg."
        )
    order: list[int] = []
    used: set[int] = set()
    for index in range(span[0], span[1] + 1):
        row = next((c for c in chirps if c[0] <= index <= c[1]), None)
        if row is None:
            raise DataError(f"{path}: the frame uses chirps {span[0]} to {span[1]}, but chirp {index} is not defined.")
        if any(row[4]):
            raise DataError(
                f"{path}: chirp {index} varies its profile by {list(row[4])}; only equal chirps can be read."
            )
        used.add(row[2])
        order.append(row[3])
    if len(used) != 1:
        raise DataError(
            f"{path}: the frame's chirps use profiles {sorted(used)}; only frames of one profile can be read."
        )
    return used.pop(), tuple(order) * loops


def _profile(
    path: Path, values: tuple[float, ...], channels: tuple[int, int, int], transmitters: tuple[int, ...]
) -> ChirpProfile:
    """The profile from GHz, µs (idle, ADC start, ramp end), MHz/µs, samples, ksps and the frame period in ms."""
    for (name, limits), value in zip(_CHIRP.items(), values, strict=True):
        if value not in limits:
            raise DataError(f"{path}: the {name} must be {limits}; received {value:g}. Check the file.")
    start, idle, adc_start, ramp_end, slope, samples, rate, period = values
    receivers, bits, form = channels
    if bits not in _BITS or form not in (0, 1, 2, 3):
        raise DataError(
            f"{path}: ADC bits must have the code 0, 1 or 2 and the format 0 to 3; received {bits}, {form}."
        )
    try:
        return ChirpProfile(
            start_frequency_hz=1e9 * start,
            slope_hz_s=1e12 * slope,
            sample_rate_hz=1e3 * rate,
            samples=int(samples),
            frame_period_s=1e-3 * period,
            adc_start_s=1e-6 * adc_start,
            receivers=receivers,
            transmitters=transmitters,
            chirp_period_s=1e-6 * (idle + ramp_end),
            bits=_BITS[bits],
            complex_samples=form != 0,
        )
    except UsageError as error:
        raise DataError(f"{path}: {error}") from error


def _studio(path: Path, whole: Any) -> TiSettings:
    device = _texts(whole, ("mmWaveDevice", "partName", "deviceName"))
    if isinstance(whole, dict) and "configUsed" in whole:
        # The setup file names the settings that were in use.
        named = path.with_name(Path(str(whole["configUsed"])).name)
        if named == path:
            raise DataError(f"{path}: configUsed names this file itself. Name the file with the chirp settings.")
        inner = read_settings(named)
        lanes, name = _lanes(path, device, interleaved=inner.lanes == 4)
        return replace(inner, lanes=lanes) if name else inner
    try:
        return _studio_settings(path, whole["mmWaveDevices"][0], device)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DataError(
            f"{path} lacks settings of mmWave Studio ({type(error).__name__}: {error}). Save it with File > Export."
        ) from error


def _studio_settings(path: Path, device: dict[str, Any], name: str) -> TiSettings:
    radio, form = device["rfConfig"], device.get("rawDataCaptureConfig", {}).get("rlDevDataFmtCfg_t", {})
    adc, frame = radio["rlAdcOutCfg_t"]["fmt"], radio["rlFrameCfg_t"]
    variations = ("startFreqVar_MHz", "freqSlopeVar_KHz_usec", "idleTimeVar_usec", "adcStartTimeVar_usec")
    chirps = [
        (
            int(row["chirpStartIdx"]),
            int(row["chirpEndIdx"]),
            int(row["profileId"]),
            _whole(row["txEnable"]),
            [float(row.get(key, 0.0)) for key in variations],
        )
        for row in (item["rlChirpCfg_t"] for item in radio["rlChirps"])
    ]
    span = (int(frame["chirpStartIdx"]), int(frame["chirpEndIdx"]))
    used, transmitters = _chirps(path, chirps, span, int(frame["numLoops"]))
    profiles = [item["rlProfileCfg_t"] for item in radio["rlProfiles"]]
    row = next(item for item in profiles if int(item["profileId"]) == used)
    values = (*(float(row[key]) for key in _STUDIO_KEYS), float(frame["framePeriodicity_msec"]))
    receivers = bin(_whole(radio["rlChanCfg_t"]["rxChannelEn"])).count("1")
    lanes, found = _lanes(path, name, interleaved=int(form.get("chInterleave", 1)) == 0 and receivers == 4)
    swap = form.get("iqSwapSel")
    return TiSettings(
        _profile(path, values, (receivers, int(adc["b2AdcBits"]), int(adc["b2AdcOutFmt"])), transmitters),
        frames=int(frame.get("numFrames", 0)),
        lanes=lanes,
        order=_STUDIO_DEFAULT if not swap else "QQII",
        order_said=swap is not None,
        notes=() if found else (f"{path.name} names no device; {lanes} lanes are assumed.",),
    )


def _whole(value: Any) -> int:
    """A whole number, also written in hexadecimal."""
    return int(value, 0) if isinstance(value, str) else int(value)


def _texts(value: Any, keys: tuple[str, ...]) -> str:
    """All texts under the keys, anywhere in a tree."""
    if isinstance(value, dict):
        own = [str(item) for key, item in value.items() if key in keys and isinstance(item, str)]
        return " ".join([*own, *(_texts(item, keys) for item in value.values())])
    if isinstance(value, list):
        return " ".join(_texts(item, keys) for item in value)
    return ""
