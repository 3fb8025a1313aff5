"""Frames of a camera on the network (RTSP) or on USB, each with its instant in UTC and how that was found."""

import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any

from midspan.records import Frame
from midspan.sources.camera.decoded import luma_of
from midspan.sources.live.instants import ArrivalEnvelope, SenderReports, SourceFault

# A camera that answers does so within this; a stream that brings nothing for so long is stopped.
OPEN_S, READ_S = 3.0, 3.0
# A network camera's reports agree within this time (the first comes within 4 s, the others every 2 to 7 s, RFC 3550);
# frames before are left out: dated by their arrival they would be tens of milliseconds off.
REPORT_S = 20.0


class StampKind(Enum):
    """How a frame's instant was found, the best first; std_s: its standard deviation."""

    SENDER = "sender"  # the camera's own clock with each packet (RTCP sender reports that agree)
    ARRIVAL = "arrival"  # when it came, less what it was delayed by

    @property
    def std_s(self) -> float:
        """The instant's standard deviation, s, as measured on a stream with its clock drawn into the pictures."""
        return {"sender": 0.0005, "arrival": 0.03}[self.value]


@dataclass(frozen=True, slots=True)
class Stamped:
    """A frame and how its instant was found."""

    frame: Frame
    kind: StampKind


def frames(address: str, *, earlier: StampKind | None = None) -> Iterator[Stamped]:
    """The frames of `rtsp://…` or `usb:0`, luma only, until the stream ends or fails: a live stream has no end.

    earlier: how the frames of an earlier connection were dated: after those dated by arrival no reports are waited for.
    Raises SourceFault with one of the codes refused, not_found, no_answer, stopped, ended, damaged.
    """
    import av

    container = _opened(address)
    try:
        stream = next((one for one in container.streams if one.type == "video"), None)
        if stream is None:
            raise SourceFault("no_video", "the stream has no video")
        stream.thread_type = "SLICE"
        has_no_reports = address.startswith("usb:") or earlier is StampKind.ARRIVAL
        yield from _decoded(container, stream, 0.0 if has_no_reports else REPORT_S)
    except av.error.ExitError:
        raise SourceFault("stopped", f"no data for {READ_S:g} s") from None
    except av.error.FFmpegError as error:
        raise SourceFault("damaged", f"the stream cannot be read ({error.strerror or type(error).__name__})") from None
    finally:
        with suppress(Exception):
            container.close()
    raise SourceFault("ended", "the live stream ended")


def _opened(address: str) -> Any:
    import av

    begun_s = time.monotonic()
    try:
        if address.startswith("usb:"):
            return av.open(f"/dev/video{address[4:]}", format="v4l2", timeout=(OPEN_S, READ_S))
        return av.open(address, timeout=(OPEN_S, READ_S), options={"rtsp_transport": "tcp"})
    except av.error.ConnectionRefusedError:
        raise SourceFault("refused", "the connection is refused: nothing listens at this address") from None
    except (av.error.HTTPNotFoundError, av.error.FileNotFoundError):
        raise SourceFault("not_found", "there is no such stream or device") from None
    except (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError, av.error.PermissionError):
        raise SourceFault("unauthorized", "user and password are not accepted") from None
    except av.error.FFmpegError as error:
        # What never answers and what answers rubbish look alike, but for the time that it takes.
        if time.monotonic() - begun_s >= 0.9 * OPEN_S:
            raise SourceFault("no_answer", f"no answer for {OPEN_S:g} s") from None
        raise SourceFault("damaged", f"the answer is not a video ({error.strerror or type(error).__name__})") from None


def _decoded(container: Any, stream: Any, report_s: float) -> Iterator[Stamped]:
    """Frames with their instants: by the sender's clock once its reports agree, else by arrival."""
    # Those of the stream's first `report_s` without the sender's clock are left out.
    envelope, reports, count, first_s = ArrivalEnvelope(), SenderReports(), 0, None
    base = float(stream.time_base)
    newest_ns = -(2**62)
    for packet in container.demux(stream):
        arrived_ns = time.time_ns()
        sent_ns = _sent_ns(packet)
        if sent_ns is not None and packet.pts is not None:
            reports.take(packet.pts * base, sent_ns)
        for picture in packet.decode():
            if picture.pts is None:
                continue
            stream_s = picture.pts * base
            first_s = stream_s if first_s is None else first_s
            stamp_ns, kind = envelope.instant_ns(stream_s, arrived_ns), StampKind.ARRIVAL
            by_sender_ns = reports.instant_ns(stream_s)
            if by_sender_ns is not None:
                stamp_ns, kind = by_sender_ns, StampKind.SENDER
            elif stream_s - first_s < report_s:
                continue
            if stamp_ns > newest_ns:
                newest_ns = stamp_ns
                yield Stamped(Frame(stamp_ns, luma_of(picture), count), kind)
                count += 1


def _sent_ns(packet: Any) -> int | None:
    """When a packet was sent by the sender's clock (ns UTC), None where it does not say."""
    sidedata = getattr(packet, "iter_sidedata", None)
    for item in sidedata() if sidedata is not None else ():
        kind, data = str(getattr(item, "data_type", "")).lower(), bytes(item)
        if ("prft" in kind or "producer" in kind) and len(data) >= 8:
            return int(struct.unpack_from("<q", data)[0]) * 1_000  # it is in microseconds
    return None
