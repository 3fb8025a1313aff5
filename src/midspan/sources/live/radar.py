"""Frames of a radar whose capture card sends its raw samples by UDP, as range profiles with their instants in UTC."""

from collections.abc import Iterator

import numpy as np

from midspan.errors import DataError, UsageError
from midspan.radar.chirp import RadarInfo
from midspan.radar.interference import probed_bins
from midspan.radar.layout import Layout
from midspan.radar.range_profile import averaged, range_profile, whole_channels
from midspan.records import RangeFrame, RangeFrames
from midspan.sources.live.instants import SourceFault
from midspan.sources.radar.radar_source import without_interference
from midspan.sources.radar.udp import LiveCapture, UdpSettings

# Nothing for so long ends the reading, s.
SILENT_S = 5.0


def host_and_port(address: str) -> tuple[str, int]:
    """Where to listen, of `4098` (any address of this machine) or `192.168.33.30:4098`. Raises ValueError."""
    host, _, port = address.rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("must be a port, or a host and a port: udp:4098 or udp:192.168.33.30:4098")
    return host, int(port)


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
    heard, probed = False, probed_bins(layout.profile.bins).astype(np.int64)
    try:
        with LiveCapture(layout, UdpSettings(address=host, port=port, timeout_s=SILENT_S)) as capture:
            for block in without_interference(_blocks(capture, layout), probed, keep=True):
                heard = True
                yield RangeFrame(int(block.time_ns[0]), block.phasors[0], block.valid[0])
    except UsageError as error:
        raise SourceFault("not_found", str(error)) from None
    except DataError as error:
        raise SourceFault("stopped" if heard else "no_answer", str(error)) from None


def _blocks(capture: LiveCapture, layout: Layout) -> Iterator[RangeFrames]:
    for frame in capture.frames():
        cube = averaged(range_profile(frame.samples[None], layout.profile), layout.profile)
        yield RangeFrames(np.array([frame.time_ns]), cube, whole_channels(frame.valid[None], layout.profile))
