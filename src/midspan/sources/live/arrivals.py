"""Instants of what a sender without a clock sends, by its arrivals."""

from midspan.records import NANOSECONDS

# The least delay among this number of arrivals is taken for none.
ENVELOPE = 600


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
