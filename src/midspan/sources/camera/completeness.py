"""Whether a video holds what its header declares: its last stamp compared with its length, else frames counted."""

from dataclasses import replace
from pathlib import Path

from midspan.errors import DataError
from midspan.sources.camera.cut_off import cut_off
from midspan.sources.camera.packets import Packets

# A video that holds this share, and at least this long, less than its header declares broke off while it was copied.
MAX_LOST = 0.03
MIN_MISSING_S = 1.0


def missing_frames(path: Path, packets: Packets, declared: int | None) -> tuple[int, int]:
    """How many of the frames that the header declares are missing at the end, and how many are meant to be left out.

    declared: frames by the header, None where it does not say. It also counts what a player does not show: frames that
    an edit list leaves out, and an AVI's empty chunks, in which a recorder keeps the time of frames it dropped. So no
    more are missing than there is time for behind the last stamp. Raises DataError for a copy that broke off.
    """
    absent = lost = max((declared or packets.count) - packets.count, 0)
    missing_s = 0.0
    if packets.ticks is not None and packets.length_s:
        missing_s = packets.length_s - packets.last_s
        if packets.rates:
            lost = min(lost, max(round(missing_s * float(packets.rates[0])) - 1, 0))
    if lost > MAX_LOST * (declared or 1) or missing_s > max(MAX_LOST * packets.length_s, MIN_MISSING_S):
        what = f"{lost} of {declared} frames" if lost > 0 else f"{missing_s:.1f} of {packets.length_s:.1f} s"
        found = f"{what} that its header declares are not in it"
        remedy = "Copy it again; to use what is there, rewrite it first (ffmpeg -i IN -c copy OUT)."
        if packets.count == 1:
            found, remedy = f"its header declares {packets.length_s:.1f} s, and one frame is in it", "Copy it again."
        raise DataError(f"{path}: the video is truncated: {found}. {remedy}")
    return lost, absent - lost


def without_cut_frame(path: Path, packets: Packets) -> tuple[Packets, str]:
    """The packets without one that the end of the file cuts, and what is cut in words; empty where nothing is."""
    end = cut_off(path)
    if end is None:
        return packets, ""
    missing = 0
    if packets.ticks is not None and packets.rates:
        held_s = float(packets.ticks[-1] - min(packets.ticks[0], 0)) * float(packets.time_base)
        missing = round((packets.length_s - held_s) * float(packets.rates[0])) - 1
    text = f"{end.text}, about {missing} frames" if missing > 0 else end.text
    if not end.in_frame or packets.count < 2:
        return packets, text
    ticks = None if packets.ticks is None else packets.ticks[:-1]
    return replace(packets, count=packets.count - 1, ticks=ticks), text
