"""The section `radar` of a `calibration.json`, read back; `recording/stored/radar.py` writes it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from midspan.checks import CARRIER_HZ, TIME_S, ValueRange, shown
from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.recording.stored.json_values import (
    AMPLITUDE,
    ANY,
    RATIO,
    WrongValueError,
    factor,
    number,
    number_or,
    offset_of,
    section_of,
    std,
)
from midspan.recording.stored.radar import RadarCalibration, RadarTarget
from midspan.records import TimeOffset

# Of a range profile, whose transform has fewer places; of an array of antennas.
BIN = ValueRange(0.0, 1e6, "bins")
MAX_CHANNELS = 4096
SNR_DB = ValueRange(-300.0, 300.0, "dB")
# Of a target in use: calibration refuses one that follows the accelerometer less; 1 but for rounding.
COHERENCE = ValueRange(0.01, 1.001)


def radar_of(tree: dict[str, Any]) -> RadarCalibration:
    """The radar's calibration; the section's own conversion factor and range count for the best target."""
    offset = offset_of(tree, "radar")
    listed = tree.get("targets")
    if not isinstance(listed, list) or not all(isinstance(target, dict) for target in listed):
        raise WrongValueError(f"radar.targets must be a list of objects; received {shown(listed)}")
    targets = sorted(
        (_target_of(target, k, offset) for k, target in enumerate(listed, start=1)), key=lambda item: not item.used
    )
    if not targets or not targets[0].used:
        raise WrongValueError("radar.targets must hold a target in use")
    targets[0] = _as_told(targets[0], tree)
    channels = number(tree, "radar.channels", limits=ValueRange(1, MAX_CHANNELS))
    if any(len(item.target.weights) != channels for item in targets if item.used):
        raise WrongValueError(f"radar.targets must have weights for {channels:g} channels each")
    return RadarCalibration(
        targets=tuple(targets),
        offset=offset,
        variance_factor=number(tree, "radar.variance_factor", 1.0, RATIO),
        relative_std=std(tree, "radar.relative_std", targets[0].target.relative_std),
        carrier_hz=number(tree, "radar.carrier_hz", limits=CARRIER_HZ),
        channels=int(channels),
        literal=tree.get("literal") is True,
    )


def _as_told(best: RadarTarget, tree: dict[str, Any]) -> RadarTarget:
    """The best target with the section's own factor, which counts where somebody has changed it."""
    own = factor(tree, "radar.conversion_factor")
    spread = std(tree, "radar.conversion_factor_std", 0.0)
    return replace(best, target=replace(best.target, conversion_factor=own, conversion_factor_std=spread))


def _target_of(tree: dict[str, Any], count: int, offset: TimeOffset) -> RadarTarget:
    place, used = f"radar.targets[{count}]", tree.get("used") is not False
    key = f"{place}.conversion_factor"
    own = factor(tree, key) if used else number_or(tree, key, math.nan)
    target = Target(
        place_bin=number(tree, f"{place}.place_bin", limits=BIN),
        range_m=number_or(tree, f"{place}.range_m", math.nan),
        amplitude=number(tree, f"{place}.amplitude", limits=AMPLITUDE if used else ANY),
        snr_db=number_or(tree, f"{place}.snr_db", math.inf, SNR_DB),
        weights=np.array([_complex_of(weight, f"{place}.weights") for weight in _list_of(tree, "weights", place)]),
        disagreement_rad=number_or(tree, f"{place}.disagreement_rad", 0.0),
        conversion_factor=own,
        conversion_factor_std=number_or(tree, f"{place}.conversion_factor_std", 0.0 if used else math.inf),
        time_offset_s=number_or(tree, f"{place}.time_offset_s", offset.value_s if used else math.nan, TIME_S),
        time_offset_std_s=number_or(tree, f"{place}.time_offset_std_s", math.inf),
        coherence=number_or(tree, f"{place}.coherence", 1.0 if used else 0.0, COHERENCE if used else ANY),
        clutter=number_or(tree, f"{place}.clutter", math.nan),
        leak=_complex_of(tree.get("leak", [0.0, 0.0]), f"{place}.leak"),
        background=_background_of(tree, place),
        reach_bins=number_or(tree, f"{place}.reach_bins", 0.0, BIN),
        modulation_rad=number_or(tree, f"{place}.modulation_rad", math.nan),
        phase_noise_rad2=number_or(tree, f"{place}.phase_noise_rad2", 0.0),
        noise_m=number_or(tree, f"{place}.noise_std_mm", math.inf) / 1e3,
    )
    return RadarTarget(target, used, str(tree.get("reason", "")))


def _background_of(tree: dict[str, Any], place: str) -> Background | None:
    section = section_of(tree, "background")
    if section is None:
        return None
    where = f"{place}.background"
    bins = [number({"bins": value}, f"{where}.bins", limits=BIN) for value in _list_of(section, "bins", where)]
    phasors = [_complex_of(pair, f"{where}.phasors") for pair in _list_of(section, "phasors", where)]
    if len(bins) != len(phasors):
        raise WrongValueError(f"{where} must have as many phasors as bins; received {len(phasors)} and {len(bins)}")
    return Background(np.array(bins), np.array(phasors))


def _list_of(tree: dict[str, Any], key: str, place: str) -> list[Any]:
    listed = tree.get(key)
    if not isinstance(listed, list) or not listed:
        raise WrongValueError(f"{place}.{key} must be a list; received {shown(listed)}")
    return listed


def _complex_of(pair: Any, key: str) -> complex:
    both = isinstance(pair, list) and len(pair) == 2
    if not both or not all(type(n) in (int, float) and n in ANY for n in pair):
        raise WrongValueError(f"{key} must be [real, imaginary], two numbers {ANY}; received {shown(pair)}")
    return complex(*pair)
