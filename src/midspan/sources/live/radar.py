"""Frames of a radar whose capture card sends its raw samples by UDP, as range profiles with their instants in UTC."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.radar.chirp import RadarInfo
from midspan.radar.interference import Interference, floor_of, probed_bins
from midspan.radar.layout import Layout
from midspan.radar.range_profile import averaged, range_profile, whole_channels
from midspan.records import RangeFrame
from midspan.sources.live.fault import SourceFault
from midspan.sources.radar.ti_config import read_settings
from midspan.sources.radar.udp import LiveCapture, UdpSettings

# Nothing for so long ends the reading, s.
SILENT_S = 5.0


def host_and_port(address: str) -> tuple[str, int]:
    """Where to listen, of `4098` (any address of this machine) or `192.168.33.30:4098`. Raises ValueError."""
    host, _, port = address.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("must be a port, or a host and a port: udp:4098 or udp:192.168.33.30:4098")
    return host, int(port)


def live_layout(config: Path, iq_order: str) -> Layout:
    """How the samples of a radar with these settings are ordered. Raises DataError."""
    settings = read_settings(config)
    if settings.header:
        raise DataError(f"{config}: lvdsStreamCfg enableHeader = 1 cannot be read. Capture with 0.")
    order = settings.order if iq_order == "auto" else iq_order
    try:
        return Layout(settings.profile, order, settings.lanes)
    except UsageError as error:
        raise DataError(f"{config}: {error}") from None


def live_info(layout: Layout) -> RadarInfo:
    """What a recording of the profiles would know of its source."""
    profile = layout.profile
    return RadarInfo(
        kind="slow-time I/Q",
        carrier_hz=profile.carrier_hz,
        frame_rate_hz=profile.frame_rate_hz,
        frame_count=None,
        channels=profile.receivers * len(set(profile.transmitters)),
        range_m=profile.axis.range_m,
        profile=profile,
    )


def profiles(address: str, layout: Layout) -> Iterator[RangeFrame]:
    """Range profiles as they come, until the card is silent. Raises SourceFault: not_found, no_answer, stopped."""
    host, port = host_and_port(address)
    heard, interference, probed = False, Interference(), probed_bins(layout.profile.bins).astype(np.int64)
    try:
        with LiveCapture(layout, UdpSettings(address=host, port=port, timeout_s=SILENT_S)) as capture:
            for frame in capture.frames():
                heard = True
                cube = averaged(range_profile(frame.samples[None], layout.profile), layout.profile)
                valid = whole_channels(frame.valid[None], layout.profile)
                if len(probed) and interference.found(floor_of(cube[..., probed], valid))[0]:
                    valid = np.zeros_like(valid)
                yield RangeFrame(frame.time_ns, cube[0], valid[0])
    except UsageError as error:
        raise SourceFault("not_found", str(error)) from None
    except DataError as error:
        raise SourceFault("stopped" if heard else "no_answer", str(error)) from None
