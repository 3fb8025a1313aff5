"""Videos through PyAV (FFmpeg): the luma plane as it was decoded, with the container's time stamps."""

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.signals.health import clock
from midspan.sources.camera.frames import FrameInfo, FrameRequest, FrameSource
from midspan.sources.camera.luma_plane import depth_of, luma_of
from midspan.sources.camera.packets import Packets, scan
from midspan.sources.camera.timing import file_times, grid, rate_times

_LOSSLESS = {"ffv1", "rawvideo", "huffyuv", "ffvhuff", "png", "utvideo", "magicyuv", "v210", "zlib", "bmp", "tiff"}
_LOSSY = {
    "h264",
    "hevc",
    "mjpeg",
    "mpeg4",
    "mpeg2video",
    "mpeg1video",
    "vp8",
    "vp9",
    "av1",
    "wmv3",
    "prores",
    "dnxhd",
    "theora",
}
_RATE_TOLERANCE = 0.01
# A video that holds this share, and at least this long, less than its header declares broke off while it was copied.
MOST_LOST = 0.03
LEAST_MISSING_S = 1.0


class VideoFrames(FrameSource):
    """Frames of a video in presentation order; memory holds a few frames, whatever the length."""

    def __init__(self, path: Path, request: FrameRequest) -> None:
        self._path = path
        self._request = request
        self._packets: Packets | None = None
        self._times: Nanoseconds | None = None
        self._notes: list[str] = []
        self._lost = 0
        self._kind: tuple[tuple[int, ...], np.dtype[Any]] | None = None
        with _opened(path) as container:
            stream = container.streams.video[0]
            self._size = (int(stream.codec_context.width), int(stream.codec_context.height))
            self._depth = depth_of(stream.codec_context.pix_fmt)
            self._codec = f"{stream.codec_context.name} {stream.codec_context.pix_fmt}"
            self._declared = int(stream.frames) or None
            if stream.codec_context.name in ("vp8", "vp9") and not self._size[0]:
                raise DataError(f"{path} has no picture size. Check that the file is whole.")

    @property
    def info(self) -> FrameInfo:
        """Size, depth, codec; the number of frames once the file's packets were counted, before that as declared."""
        name = self._codec.split()[0].removeprefix("lib")
        lossless = True if name in _LOSSLESS else False if name in _LOSSY else None
        count = self._packets.count if self._packets is not None else self._declared
        damage = (f"{self._lost} frames are damaged and were passed over",) if self._lost else ()
        return FrameInfo(*self._size, self._depth, count, self._codec, lossless, tuple(self._notes), damage=damage)

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else the container, else the rate."""
        if self._times is None:
            self._times = self._all_times()
        return self._times[:: self._request.every]

    def _scanned(self) -> Packets:
        if self._packets is None:
            with _opened(self._path) as container:
                self._packets = scan(self._path, container)
                declared_s = container.duration * 1e-6 if container.duration else 0.0
            self._refuse_truncated(self._packets, declared_s)
        return self._packets

    def _refuse_truncated(self, packets: Packets, declared_s: float) -> None:
        """DataError when the file holds clearly less than its header declares: a copy that broke off."""
        lost = self._declared - packets.count if self._declared else 0
        held_s = declared_s
        if packets.ticks is not None:
            held_s = float(_container_times(packets.ticks, packets)[0][-1]) * 1e-9
        missing_s = declared_s - held_s
        if lost > MOST_LOST * max(self._declared or 1, 1) or missing_s > max(MOST_LOST * declared_s, LEAST_MISSING_S):
            what = f"{lost} of {self._declared} frames" if lost > 0 else f"{missing_s:.1f} of {declared_s:.1f} s"
            raise DataError(
                f"{self._path}: the video is truncated: {what} that its header declares are not in it. Copy it "
                "again; to use what is there, rewrite it first (ffmpeg -i IN -c copy OUT)."
            )
        if lost > 0:
            self._notes.append(f"the file ends early: {lost} of {self._declared} frames are not in it")

    def _all_times(self) -> Nanoseconds:
        packets = self._scanned()
        if self._request.times is not None:
            return file_times(self._request.times, self._path, packets.count)
        ticks = packets.ticks
        if ticks is None:
            self._notes.append("the container has no usable time stamps")
            return rate_times(self._path, self._request, packets.count)
        time_ns, note = _container_times(ticks, packets)
        self._notes += [note] if note else []
        if packets.free_running and time_ns[0] != 0:
            self._notes.append(
                f"the stream's clock starts at {time_ns[0] * 1e-9:.3f} s; its first frame counts as zero"
            )
            time_ns = time_ns - time_ns[0]
        self._tell_rate(time_ns)
        return time_ns + np.int64(round(self._request.start_s * 1e9))

    def _tell_rate(self, time_ns: Nanoseconds) -> None:
        given = self._request.rate_hz
        if given is None or time_ns.size < 2:
            return
        own_hz = clock(time_ns).rate_hz
        if abs(given / own_hz - 1.0) > _RATE_TOLERANCE:
            self._notes.append(f"rate_hz = {given:g} Hz not used: the container's time stamps say {own_hz:.6g} Hz")

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames' luma by decoding in one pass, from the key frame before `start`."""
        times = self.times_ns()
        every = self._request.every
        wanted = range(*slice(start, stop).indices(times.size))
        if not wanted:
            return
        packets = self._scanned()
        first, last = wanted[0] * every, wanted[-1] * every
        decoded = 0
        with _opened(self._path) as container:
            for number, picture in _numbered(container, packets, first):
                if number > last:
                    break
                if number >= first and number % every == 0:
                    decoded += 1
                    yield Frame(int(times[number // every]), self._checked(luma_of(picture), number), number // every)
        self._lost = max(self._lost, len(wanted) - decoded)
        if not decoded:
            raise DataError(
                f"{self._path}: none of its {packets.count} frames can be decoded. Give an undamaged video."
            )

    def _checked(self, pixels: NDArray[np.generic], number: int) -> NDArray[np.generic]:
        """The pixels of a picture that has the size and depth of the first one decoded, else DataError."""
        kind = (pixels.shape, pixels.dtype)
        self._kind = self._kind or kind
        if kind != self._kind:
            now, first = (f"{shape[1]}x{shape[0]} px of {dtype}" for shape, dtype in (kind, self._kind))
            raise DataError(
                f"{self._path}: all frames must have the size of the first ({first}); frame {number} has {now}. Split "
                "the recording where the camera's format changed."
            )
        return pixels


def _opened(path: Path) -> Any:
    import av

    try:
        container = av.open(str(path))
    except (av.error.FFmpegError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DataError(f"{path} cannot be opened as a video: {reason}. Check that the file is whole.") from error
    if not container.streams.video:
        container.close()
        raise DataError(f"{path} has no video stream. Give a file with pictures.")
    container.streams.video[0].thread_type = "AUTO"
    return container


def _numbered(container: Any, packets: Packets, first: int) -> Iterator[tuple[int, Any]]:
    """Decoded pictures with their number in presentation order, starting at or before `first`.

    With usable stamps a picture's number is the place of its stamp, so that a lost one does not shift those behind it.
    """
    stream = container.streams.video[0]
    key = packets.key_before(first)
    if key is not None and key > 0 and packets.ticks is not None:
        container.seek(int(packets.ticks[key]), stream=stream)
    number = -1
    for picture in _pictures(container, stream):
        stamp = picture.pts
        if packets.ticks is None or stamp is None:
            number += 1
        else:
            place = int(np.searchsorted(packets.ticks, stamp))
            known = place < packets.count and packets.ticks[place] == stamp
            number = place if known else number + 1
        yield number, picture


def _pictures(container: Any, stream: Any) -> Iterator[Any]:
    """All pictures that decode; a packet that does not is passed over."""
    import av

    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
            pictures = packet.decode()
        except StopIteration:
            return
        except av.error.EOFError:
            return
        except av.error.InvalidDataError:
            continue
        for picture in pictures:
            if not picture.is_corrupt:
                yield picture


def _container_times(ticks: Nanoseconds, packets: Packets) -> tuple[Nanoseconds, str]:
    """Stamps in ns; where the container rounded an exact rate to its ticks (matroska: 1 ms) the grid behind them."""
    base = packets.time_base
    plain = _exact_ns(ticks, base)
    for rate in packets.rates:
        start_ns = _grid_start(ticks, base, rate)
        if start_ns is not None:
            note = f"time stamps rounded to {float(base):g} s by the container; its rate {float(rate):.9g} Hz is used"
            return grid(ticks.size, rate, start_ns), note
    return plain, ""


def _exact_ns(ticks: Nanoseconds, base: Fraction) -> Nanoseconds:
    """Ticks to ns in whole numbers, rounded to the nearest."""
    whole, rest = np.divmod(ticks * base.numerator, base.denominator)
    return np.asarray(
        whole * 1_000_000_000 + (rest * 1_000_000_000 + base.denominator // 2) // base.denominator, dtype=np.int64
    )


def _grid_start(ticks: Nanoseconds, base: Fraction, rate: Fraction) -> int | None:
    """The start in ns of the grid of `rate` that the ticks are rounded from; None if they are not, or are exact."""
    if ticks.size < 3:
        return None
    # Deviation from the grid in ticks, exactly: both sides times the rate's numerator.
    step = Fraction(1) / rate / base
    index = np.arange(ticks.size, dtype=np.int64)
    deviation = ((ticks - ticks[0]) * step.denominator - index * step.numerator) / step.denominator
    low, high = float(deviation.min()), float(deviation.max())
    if high == low or high - low > 1.0 + 1e-6:
        return None
    # The first stamp itself starts the grid where rounding to the nearest allows it.
    shift = 0.0 if max(abs(low), abs(high)) <= 0.5 + 1e-6 else 0.5 * (low + high)
    return round(float((Fraction(int(ticks[0])) + Fraction(shift)) * base * 1_000_000_000))
