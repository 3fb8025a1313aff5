"""What live sources share: a fault with its reason code, and the instants of what comes.

A sender without a clock is dated by its arrivals, a network camera by its own clock, which its RTCP sender reports
give. A report pairs one instant of the sender's clock with one of the stream's time; every packet after it carries its
instant by the newest report. One report alone may be tens of milliseconds off, whatever the server: it is used once a
second one agrees with it.
"""

from collections.abc import Callable

from midspan.errors import DataError
from midspan.records import NANOSECONDS

# The least delay among this number of arrivals is taken for none.
ENVELOPE = 600
# Instants of packets under the same report differ by the rounding of two clocks to microseconds, ns.
ROUNDING_NS = 2_000
# Two reports that are five to eight seconds apart differ by the drift of the sender's clocks, 0.8 ms at 100 ppm, ns.
MAX_DIFFERENCE_NS = 2_000_000
# Whoever waits for a source looks so often whether it is to end, s: people who change settings wait for it.
LOOK_S = 0.25

Ended = Callable[[], bool]
"""Whether a source is to be left."""


def never() -> bool:
    """A source that is read until it fails."""
    return False


class SourceFault(DataError):
    """`code`: one of the reason codes; the text is for people, and holds no secret."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code

    def __reduce__(self) -> tuple[type["SourceFault"], tuple[str, str]]:
        """What a copy in another process is made of."""
        return SourceFault, (self.code, str(self))


class ArrivalEnvelope:
    """Instants by arrivals: the sender's own time and the least delay that was seen."""

    def __init__(self) -> None:
        self._delays: list[float] = []

    def instant_ns(self, stream_s: float, arrived_ns: int) -> int:
        """The instant (ns UTC) of what has the sender's time `stream_s` and came at `arrived_ns`."""
        self._delays.append(arrived_ns / NANOSECONDS - stream_s)
        if len(self._delays) > ENVELOPE:
            self._delays.pop(0)
        return round((stream_s + min(self._delays)) * NANOSECONDS)


class SenderReports:
    """The sender's clock against the stream's time."""

    def __init__(self) -> None:
        # Offsets (ns) of the sender's clock from the stream's: of the newest packet, of the newest report, and in use.
        self._packet_ns: int | None = None
        self._report_ns: int | None = None
        self._offset_ns: int | None = None

    def take(self, stream_s: float, sent_ns: int) -> None:
        """A packet of the stream's time `stream_s` carries the sender's instant `sent_ns` (UTC)."""
        offset_ns = sent_ns - round(stream_s * NANOSECONDS)
        # The first packet after a stream's first report may carry the instant of another frame.
        is_second_packet = _agree(offset_ns, self._packet_ns, ROUNDING_NS)
        self._packet_ns = offset_ns
        if not is_second_packet or _agree(offset_ns, self._report_ns, ROUNDING_NS):
            return
        if _agree(offset_ns, self._report_ns, MAX_DIFFERENCE_NS):
            self._offset_ns = offset_ns
        self._report_ns = offset_ns

    def instant_ns(self, stream_s: float) -> int | None:
        """The instant (ns UTC) of the stream's time `stream_s`; None before two reports agree."""
        return None if self._offset_ns is None else self._offset_ns + round(stream_s * NANOSECONDS)


def _agree(first_ns: int, second_ns: int | None, most_ns: int) -> bool:
    """Whether two offsets are known and agree within `most_ns`."""
    return second_ns is not None and abs(first_ns - second_ns) <= most_ns
