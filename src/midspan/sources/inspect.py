"""What is in a file, stream by stream, as trees of plain values: nothing is changed or judged."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from midspan import _core
from midspan.errors import DataError, MidspanError, UsageError
from midspan.progress import Progress, silent
from midspan.radar.channels import noise_variance
from midspan.radar.following import peaks
from midspan.radar.frames import RadarFrames, collected, without_holes
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries
from midspan.signals.acceleration import unusable_samples
from midspan.signals.clipping import clipped
from midspan.signals.health import clock, frozen
from midspan.signals.stamps import shown
from midspan.sources.accelerometer.channel import Channel, Stored
from midspan.sources.accelerometer.clock import NOT_A_TIME
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.phone import open_phone_log
from midspan.sources.accelerometer.units import SI_UNITS, measures, si_factor
from midspan.sources.boundary import available_bytes, shown_bytes
from midspan.sources.camera.formats import IMAGES, is_stack, is_table, open_frames, require_readable
from midspan.sources.camera.frames import FrameRequest, timed_or_counted
from midspan.sources.radar.radar_source import RadarSource
from midspan.sources.thermal.formats import is_thermal, open_pictures, open_thermal
from midspan.sources.thermal.temperatures import ThermalRequest
from midspan.vision.frame_source import FrameSource

# Numbers alone, in an order that only the settings of the sensor tell.
RAW = (".bin",)
# Files of these names may hold pictures of 16 bits that are counts of temperature.
COUNTED = (".tif", ".tiff", ".png", ".npy", ".npz")

# Frames looked at unless all are asked for, and peaks of a radar that are reported.
LOOKED_AT, MAX_PEAKS = 600, 12

Tree = dict[str, Any]
# What is reported of a chirp.
CHIRP = (
    *("start_frequency_hz", "bandwidth_hz", "slope_hz_s", "samples", "sample_rate_hz", "chirps", "receivers", "bits"),
    "complex_samples",
)
NOTHING: Tree = {"smallest": None, "largest": None}


def inspect_file(path: Path, progress: Progress = silent) -> Tree:
    """What is in a single file: its channels with their units and rates, or its frames."""
    require_readable(path)
    if path.suffix.lower() in RAW:
        raise UsageError(
            f"{path}: a raw capture ({path.suffix}) does not state its data layout. Write a recording.toml with "
            f'[radar] file = "{path.name}" and config = the .cfg or .json that it was recorded with; inspect that '
            "recording."
        )
    try:
        if is_thermal(path) or path.suffix.lower() in IMAGES or is_stack(path):
            raise UsageError(f"{path} holds frames.")
        found = list_channels(path)
    except MidspanError as first:
        if is_table(path):
            # Decided by its name: a damaged table is not tried as a video.
            raise
        try:
            return {"file": str(path), "frames": _file_of_frames(path, progress)}
        except MidspanError as second:
            if path.suffix.lower() in IMAGES:
                raise
            # No table by its name, and a video that cannot be used: what is wrong with the video counts.
            raise (second if isinstance(first, UsageError) and isinstance(second, DataError) else first) from None
    channels = [
        {"name": one.name, "unit": one.unit, "rate_hz": one.rate_hz, "samples": one.size, **values_range}
        for one, values_range in zip(found.channels, _ranges(found.channels), strict=True)
    ]
    return {"file": str(path), "notes": list(found.notes), "warnings": list(found.damage), "channels": channels}


def inspect_phone(path: Path, progress: Progress = silent) -> Tree:
    """What is in a phone's log: its tables, which axis is vertical, and its films."""
    log = open_phone_log(path)
    tree: Tree = {"file": str(path), "app": log.app, "pauses": log.pauses}
    for name, table in (("acceleration", log.acceleration), ("gravity", log.gravity), ("gyroscope", log.gyroscope)):
        if table is not None:
            own = {"file": table.path.relative_to(path).as_posix(), "columns": list(table.columns), "unit": table.unit}
            tree[name] = {**own, "samples": table.channels[0].size, "mean": list(table.mean), **_clock(table.time_ns)}
    upright = log.vertical
    tree["vertical"] = (
        None if upright is None else {"column": log.acceleration.columns[upright.axis], **asdict(upright)}
    )
    if log.gyroscope is not None and log.camera_axes is not None:
        tree["gyroscope"]["camera_axes"] = [log.gyroscope.along(axis) for axis in log.camera_axes]
    films = [(film.relative_to(path).as_posix(), _file_of_frames(film, progress)) for film in log.films]
    return {**tree, "films": [{"file": name, **branch} for name, branch in films]}


def _file_of_frames(path: Path, progress: Progress) -> Tree:
    """The frames of a file without settings: their clock is None where the file has none."""
    source, timed = timed_or_counted(lambda rate_hz: _opened(path, FrameRequest(rate_hz=rate_hz)))
    celsius = source.info.radiometric
    branch, _ = frames_tree(source, False, progress, celsius)
    if not timed:
        branch |= dict.fromkeys(("start", "start_s", "duration_s", "rate_hz", "jitter_ms"))
    if celsius and not is_thermal(path):
        branch["notes"].append("temperatures, as [infrared] reads them; [camera] reads them as grey levels")
    return branch


def _opened(path: Path, request: FrameRequest) -> FrameSource:
    """The frames of a file: temperatures where it is sure, or where pictures of 16 bits can be some; else light."""
    if is_thermal(path) or not (path.is_dir() or path.suffix.lower() in COUNTED):
        return open_pictures(path, request)
    light = open_frames(path, request)
    if light.info.bit_depth == 8:
        return light
    try:
        return open_thermal(path, ThermalRequest(request))
    except DataError:
        return light


def _ranges(channels: Sequence[Channel]) -> list[Tree]:
    """Each channel's range. One larger than the available memory is not read where others of its file can be used."""
    limit = available_bytes()
    needed = [channel.stored.needed_bytes if isinstance(channel.stored, Stored) else 0 for channel in channels]
    if min(needed) > limit:
        return [_range(channel) for channel in channels]
    return [
        NOTHING | {"missing": None, "not_read": f"it takes {shown_bytes(size)}; {shown_bytes(limit)} are available"}
        if size > limit
        else _range(channel)
        for channel, size in zip(channels, needed, strict=True)
    ]


def _range(channel: Channel) -> Tree:
    """Smallest and largest value, a clock's as dates, None where there is no number; how many values are none."""
    known = channel.values
    known = known[np.isfinite(known)]
    if channel.unit == "ns":
        known = known[known != NOT_A_TIME]
    missing = {"missing": channel.size - len(known)}
    if not len(known):
        return NOTHING | missing
    smallest, largest = known.min(), known.max()
    if channel.unit == "ns":
        return {"smallest": shown(int(smallest)), "largest": shown(int(largest)), **missing}
    return {"smallest": float(smallest), "largest": float(largest), **missing}


def _clock(time_ns: Nanoseconds) -> Tree:
    start = {"start": shown(int(time_ns[0])), "start_s": time_ns[0] / NANOSECONDS}
    if len(time_ns) < 2:
        return {**start, "duration_s": 0.0, "rate_hz": None, "jitter_ms": None, "gaps": []}
    found = clock(time_ns)
    gaps = zip(found.gaps, found.gap_s, strict=True)
    return {
        **start,
        "duration_s": (time_ns[-1] - time_ns[0]) / NANOSECONDS,
        "rate_hz": found.rate_hz,
        "jitter_ms": 1e3 * found.jitter_s,
        "gaps": [{"at_s": time_ns[k] / NANOSECONDS, "length_s": float(length)} for k, length in gaps],
    }


def series_tree(series: TimeSeries, unit: str) -> tuple[Tree, Nanoseconds]:
    """What is in a channel, and its stamps; unit: of its values."""
    value = series.value
    finite = value[np.isfinite(value)]
    if not len(finite):
        raise DataError(f"{series.name!r} holds no number. Choose another channel.")
    rate = clock(series.time_ns).rate_hz
    # What one of the file's unit is in SI; None where that takes a sensitivity.
    quantity = next(name for name, si in SI_UNITS.items() if si == unit)
    in_si = si_factor(series.unit, quantity, None) if measures(series.unit, quantity) else None
    branch = {
        "channel": series.name,
        "unit": series.unit,
        "samples": len(value),
        **_clock(series.time_ns),
        "mean": float(finite.mean()),
        "std": float(finite.std()),
        "smallest": float(finite.min()),
        "largest": float(finite.max()),
        "value_unit": unit,
        "unit_in_si": in_si,
        "missing_samples": int(len(value) - len(finite)),
        "frozen_samples": int(np.count_nonzero(frozen(value, rate))),
        "clipped_samples": int(np.count_nonzero(clipped(value))),
        "notes": list(series.notes),
        "warnings": list(series.damage),
    }
    return branch, series.time_ns


def acceleration_tree(series: TimeSeries) -> tuple[Tree, Nanoseconds]:
    """What is in a channel of acceleration, with what of it cannot be used, and its stamps."""
    branch, time_ns = series_tree(series, "m/s^2")
    branch["warnings"] += unusable_samples(series)
    return branch, time_ns


def frames_tree(
    source: FrameSource, every_frame: bool, progress: Progress, thermal: bool = False
) -> tuple[Tree, Nanoseconds]:
    """What is in frames, and their stamps; every_frame: look at all of them for frozen ones, not only at the first."""
    times = source.times_ns()
    count = len(times) if every_frame else min(len(times), LOOKED_AT)
    seen, same, dark, bright = 0, 0, 0, 0
    before = None
    low_c, high_c = np.inf, -np.inf
    top = float(2 ** min(source.info.bit_depth, 16) - 1)
    for frame in source.frames(0, count):
        progress(seen, count, "looking at frames")
        picture = np.asarray(frame.pixels, dtype=frame.pixels.dtype.type)
        same += before is not None and np.array_equal(before, picture)
        dark += _core.is_dark(picture, 1)
        bright += float(np.mean(picture >= top)) > 0.2
        if picture.dtype.kind == "f":
            low_c, high_c = min(low_c, float(np.nanmin(picture))), max(high_c, float(np.nanmax(picture)))
        before, seen = picture, seen + 1
    progress(1, 1, "looking at frames")
    info = source.info
    branch = {
        "width": info.width,
        "height": info.height,
        "bit_depth": info.bit_depth,
        "codec": info.codec,
        "lossless": info.lossless,
        "frames_used": len(times),
        "frames_in_file": info.frame_count,
        **_clock(times),
        "frames_looked_at": seen,
        "frozen_frames": int(same),
        "dark_frames": int(dark),
        "saturated_frames": int(bright),
        **({"coldest_c": low_c, "warmest_c": high_c} if thermal and np.isfinite(high_c - low_c) else {}),
        "notes": [*info.notes, *info.damage, *info.notices],
    }
    return branch, times


def radar_tree(source: RadarSource, every_frame: bool, progress: Progress) -> tuple[Tree, Nanoseconds]:
    """What is in a radar's file, and the stamps of its frames; every_frame: look for holes in all of them.

    Raises DataError where the file holds no frames.
    """
    info, times = source.info, source.times_ns()
    if not len(times):
        raise DataError("radar.file: holds no frames.")
    count = min(len(times), LOOKED_AT)
    frames = collected(source.profiles(0, count), count, progress, "looking at radar frames")
    holes, looked = int(np.count_nonzero(~frames.valid.all(axis=1))), count
    if every_frame and len(times) > count:
        for block in source.slow_time(np.zeros(1), count):
            holes += int(np.count_nonzero(~block.valid.all(axis=1)))
            looked += len(block.time_ns)
            progress(looked, len(times), "looking at radar frames")
    # Bins of single targets are no grid.
    steps = np.diff(info.range_m)
    branch = {
        "kind": info.kind,
        "frames": len(times),
        "channels": info.channels,
        "bins": info.bins,
        "carrier_hz": info.carrier_hz,
        "cycle_mm": 1e3 * info.axis.cycle_m,
        "limit_speed_mm_s": 1e3 * info.limit_speed_m_s,
        "range_resolution_m": float(steps[0]) if len(steps) and np.allclose(steps, steps[0]) else None,
        "largest_range_m": float(np.nanmax(info.range_m)) if np.isfinite(info.range_m).any() else None,
        "iq_order": info.iq_order,
        "chirp": None if info.profile is None else {key: getattr(info.profile, key) for key in CHIRP},
        "frames_looked_at": looked,
        "frames_with_holes": holes,
        "peaks": _peaks(frames, info.range_m),
        "notes": list(info.notes),
        "warnings": list(info.warnings),
        **_clock(times),
    }
    return branch, times


def _peaks(frames: RadarFrames, range_m: Floats) -> list[Tree]:
    """The strongest peaks of the mean profile, the strongest first, in dB over the noise of one frame and channel."""
    if not frames.valid.any() or len(frames.time_ns) < 2:
        return []
    z = without_holes(frames).phasors
    noise = noise_variance(z)
    power = np.mean(np.abs(z) ** 2, axis=(0, 1))
    if not noise > 0.0:
        return []
    found = sorted(peaks(z, noise), key=lambda place: -power[round(place)])[:MAX_PEAKS]
    return [
        {
            "bin": place,
            "range_m": float(np.interp(place, np.arange(len(range_m)), range_m)),
            "level_db": float(10.0 * np.log10(max(power[round(place)] / noise, 1e-6))),
        }
        for place in found
    ]


def overlap(spans: dict[str, tuple[int, int]]) -> Tree:
    """Where streams overlap, by the first and last stamp (ns) of each."""
    if len(spans) < 2:
        return {}
    first = max(span[0] for span in spans.values())
    last = min(span[1] for span in spans.values())
    return {
        "start": shown(first),
        "duration_s": max(0.0, (last - first) / NANOSECONDS),
        "streams": list(spans),
        "overlapping": last > first,
    }
