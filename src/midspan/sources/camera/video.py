"""Videos through PyAV (FFmpeg): the luma plane as it was decoded, with the container's time stamps."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Frame, Nanoseconds
from midspan.signals.health import clock
from midspan.sources.accelerometer.select import RATE_TOLERANCE
from midspan.sources.boundary import head_of, require_memory
from midspan.sources.camera.decoded import depth_of, luma_of, turn_of
from midspan.sources.camera.frames import FrameRequest, file_times, grid, named, rate_times
from midspan.sources.camera.packets import (
    Packets,
    declared_rate,
    missing_frames,
    scan,
    times_of_taking,
    without_cut_frame,
)
from midspan.sources.camera.picture_header import picture_bytes
from midspan.vision.frame_source import FrameInfo, FrameSource

_LOSSLESS = "ffv1 rawvideo huffyuv ffvhuff png utvideo magicyuv v210 zlib bmp tiff"
_LOSSY = "h264 hevc mjpeg mpeg4 mpeg2video mpeg1video vp8 vp9 av1 wmv3 prores dnxhd theora"
# Codecs that hold a checksum of every slice. Where one is wrong FFmpeg says so in its log only, and gives the picture.
_CHECKED_CODECS = ("ffv1",)
_CHECKSUM_WRONG = "CRC mismatch"
# FFmpeg's names of containers that hold their pictures themselves; scripts and playlists (concat, hls, dash, sdp) name
# other files.
_CONTAINERS = (
    "mov,matroska,webm,avi,mpegts,mpegtsraw,mpeg,mpegvideo,m4v,asf,asf_o,flv,live_flv,kux,mjpeg,mjpeg_2000,mpjpeg,"
    "smjpeg,ogg,yuv4mpegpipe,h261,h263,h264,hevc,vvc,evc,av1,obu,gif,gif_pipe,apng,nut,ivf,mxf,dv,dhav,cine,ser,mlv,"
    "rm,nsv,wtv,swf,amv,vc1,vc1test,dirac,dnxhd,cavsvideo,avs2,avs3,ivr,pva,gxf,webp_anim,webp_pipe,jpeg_pipe,"
    "png_pipe,bmp_pipe,tiff_pipe,j2k_pipe,jpegls_pipe,jpegxl_pipe,jpegxl_anim,dpx_pipe,exr_pipe,pgm_pipe,pam_pipe,fits"
)


class VideoFrames(FrameSource):
    """Frames of a video in presentation order; memory holds a few frames, whatever the length."""

    def __init__(self, path: Path, request: FrameRequest) -> None:
        self._path, self._request = path, request
        self._packets: Packets | None = None
        self._times: Nanoseconds | None = None
        self._notes: list[str] = []
        self._damage: list[str] = []
        self._notices: list[Notice] = []
        self._lost: set[int] = set()
        self._kind: tuple[tuple[int, ...], np.dtype[Any]] | None = None
        # Of pictures that FFmpeg reads (GIF).
        require_memory(path, picture_bytes(head_of(path)), "a picture")
        with _opened(path) as container:
            stream = container.streams.video[0]
            self._size = (int(stream.codec_context.width), int(stream.codec_context.height))
            self._depth = depth_of(stream.codec_context.pix_fmt)
            self._codec = f"{stream.codec_context.name} {stream.codec_context.pix_fmt}"
            self._declared = int(stream.frames) or None
            self._taken_hz = declared_rate(path, {**stream.metadata, **container.metadata})
            if stream.codec_context.name in ("vp8", "vp9") and not self._size[0]:
                raise DataError(f"{path} has no picture size. Check that the file is whole.")
            first = next(_pictures(container, stream), None)
            self._turns, notice = turn_of(first) if first is not None else (0, None)
            self._notices += [notice] if notice else []
            self._size = self._size[::-1] if self._turns % 2 else self._size

    @property
    def info(self) -> FrameInfo:
        """Size, depth, codec; the number of frames once the file's packets were counted, before that as declared."""
        name = self._codec.split()[0].removeprefix("lib")
        lossless = True if name in _LOSSLESS.split() else False if name in _LOSSY.split() else None
        count = self._packets.count if self._packets is not None else self._declared
        damage = (*self._damage, *_lost_frames(self._lost, self._packets))
        return FrameInfo(
            *self._size,
            self._depth,
            count,
            self._codec,
            lossless,
            tuple(self._notes),
            damage=damage,
            notices=tuple(self._notices),
            quarter_turns=self._turns,
        )

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else the container, else the rate."""
        if self._times is None:
            self._times = self._all_times()
        return self._times[:: self._request.every]

    def _scanned(self) -> Packets:
        if self._packets is None:
            with _opened(self._path) as container:
                packets = scan(self._path, container)
            lost, hidden = missing_frames(self._path, packets, self._declared)
            if lost:
                self._damage.append(f"the file ends early: {lost} of {self._declared} frames are missing")
            if hidden:
                self._notes.append(
                    f"{hidden} of {self._declared} frames are left out by an edit list (trimmed) or were dropped by "
                    "the recorder; the times of the others are right"
                )
            self._packets, cut = without_cut_frame(self._path, packets)
            self._damage += [cut] if cut else []
        return self._packets

    def _all_times(self) -> Nanoseconds:
        packets = self._scanned()
        if self._request.times is not None:
            return file_times(self._request.times, self._path, packets.count)
        ticks = packets.ticks
        if ticks is None:
            self._notes.append("the container has no usable time stamps")
            return rate_times(self._path, self._request, packets.count)
        time_ns = _exact_ns(ticks, packets.time_base)
        for rate in packets.rates:
            start_ns = _grid_start(ticks, packets.time_base, rate)
            if start_ns is not None:
                tick_s, rate_hz = float(packets.time_base), float(rate)
                self._notes.append(
                    f"time stamps rounded to {tick_s:g} s by the container; its rate {rate_hz:.9g} Hz is used"
                )
                time_ns = grid(ticks.size, rate, start_ns)
                break
        if packets.free_running and time_ns[0] != 0:
            self._notes.append(f"the stream's clock starts at {time_ns[0] * 1e-9:.3f} s; the first frame is set to 0 s")
            time_ns = time_ns - time_ns[0]
        time_ns, notice = times_of_taking(time_ns, self._taken_hz, self._request.rate_hz)
        self._notices += [notice] if notice else []
        given_hz = self._request.rate_hz
        if given_hz is not None and time_ns.size > 1:
            own_hz = clock(time_ns).rate_hz
            if abs(given_hz / own_hz - 1.0) > RATE_TOLERANCE:
                self._notes.append(
                    f"rate_hz = {given_hz:g} Hz not used: the container's time stamps give {own_hz:.6g} Hz"
                )
        return time_ns + np.int64(round(self._request.start_s * 1e9))

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames' luma by decoding in one pass, from the key frame before `start`."""
        times = self.times_ns()
        every = self._request.every
        wanted = range(*slice(start, stop).indices(times.size))
        if not wanted:
            return
        packets = self._scanned()
        first, last = wanted[0] * every, wanted[-1] * every
        missing = set(wanted)
        with _opened(self._path) as container:
            for number, picture in _numbered(container, packets, first):
                if number > last:
                    break
                if number >= first and number % every == 0:
                    index = number // every
                    missing.discard(index)
                    pixels = luma_of(picture)
                    if self._turns:
                        pixels = np.ascontiguousarray(np.rot90(pixels, self._turns))
                    yield Frame(int(times[index]), self._checked(pixels, number), index)
        self._lost |= {index * every for index in missing}
        if len(missing) == len(wanted) > 1:
            raise DataError(
                f"{self._path}: none of the {len(wanted)} frames from {first} to {last} can be decoded. Give an "
                "undamaged video."
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


def _lost_frames(lost: set[int], packets: Packets | None) -> tuple[str, ...]:
    """How many frames are damaged, which, and how many build on them; nothing where none is."""
    if not lost:
        return ()
    text = f"{len(lost)} frames are damaged and were skipped: frame {named(sorted(lost))}"
    after = _building_on(lost, packets) if packets is not None else 0
    built = f"{after} frames after damaged ones, up to the next key frame, may be partly wrong"
    return (text, built) if after else (text,)


def _building_on(lost: set[int], packets: Packets) -> int:
    """The number of frames between a damaged one and the next key frame, where there are key frames."""
    if not packets.keys:
        return 0
    numbers = np.array(sorted(lost))
    keys = np.array([*packets.keys, packets.count])
    until = keys[np.searchsorted(keys[:-1], numbers, side="right")]
    touched = np.zeros(packets.count + 1, dtype=np.int64)
    np.add.at(touched, np.minimum(numbers + 1, until), 1)
    np.add.at(touched, until, -1)
    inside = np.cumsum(touched)[:-1] > 0
    inside[numbers] = False
    return int(np.count_nonzero(inside))


def _opened(path: Path) -> Any:
    import av

    try:
        # With its protocol: FFmpeg takes what stands before a colon in a name for one.
        container = av.open(
            f"file:{path.absolute()}", options={"format_whitelist": _CONTAINERS}, metadata_errors="replace"
        )
    except av.error.ArgumentError as error:
        raise DataError(
            f"{path} cannot be opened as a video: it is damaged, or a script or playlist that names other files. Give "
            "the video itself."
        ) from error
    except (av.error.FFmpegError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DataError(f"{path} cannot be opened as a video: {reason}. Check that the file is whole.") from error
    video = container.streams.video
    refusal = ""
    if not video:
        refusal = " has no video stream. Give a file with pictures."
    elif video[0].codec_context is None:
        refusal = ": its codec is unknown. Check that the file is complete, or convert it with another codec."
    if refusal:
        container.close()
        raise DataError(f"{path}{refusal}")
    # What a decoder reports on damage belongs to a packet only while no other packet is decoded with it.
    video[0].thread_type = "SLICE" if video[0].codec_context.name in _CHECKED_CODECS else "AUTO"
    return container


def made_s(path: Path) -> float | None:
    """When a video was made by its own header, s since 1970; None where it does not say, or cannot be read.

    Cameras write when they began to record, or when they ended.
    """
    try:
        with _opened(path) as container:
            made = datetime.fromisoformat(container.metadata["creation_time"])
            return (made if made.tzinfo else made.replace(tzinfo=UTC)).timestamp()
    except (DataError, KeyError, ValueError, OSError):
        return None


def _numbered(container: Any, packets: Packets, first: int) -> Iterator[tuple[int, Any]]:
    """Decoded pictures with their number in presentation order, starting at or before `first`."""
    # With usable stamps a picture's number is the place of its stamp, so that a lost one does not shift those behind
    # it.
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
    """All pictures that decode whole; a packet that does not is passed over."""
    import av

    checked, spoiled = stream.codec_context.name in _CHECKED_CODECS, False
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
            with _decoder_errors(checked) as reported:
                pictures = packet.decode()
        except StopIteration:
            return
        except av.error.EOFError:
            return
        except av.error.FFmpegError as error:
            if error.errno == errno.ENOMEM:
                raise MemoryError from error
            spoiled = checked
            continue
        if checked:
            # Pictures up to the next key frame are decoded with what was estimated from the damaged one.
            wrong = any(_CHECKSUM_WRONG in message for _, _, message in reported)
            spoiled = wrong or (spoiled and not any(picture.key_frame for picture in pictures))
        for picture in () if spoiled else pictures:
            if not picture.is_corrupt:
                yield picture


@contextmanager
def _decoder_errors(listen: bool) -> Iterator[list[tuple[int, str, str]]]:
    """What the decoder logs as errors meanwhile: (level, decoder, message)."""
    from av import logging

    if not listen:
        yield []
        return
    level = logging.get_level()
    logging.set_level(logging.ERROR)
    try:
        # Of all threads: a slice is decoded by any of them.
        with logging.Capture(False) as reported:
            yield reported
    finally:
        logging.set_level(level)


def _exact_ns(ticks: Nanoseconds, base: Fraction) -> Nanoseconds:
    """Ticks to ns in whole numbers, rounded to the nearest."""
    whole, rest = np.divmod(ticks * base.numerator, base.denominator)
    rest_ns = (rest * NANOSECONDS + base.denominator // 2) // base.denominator
    return np.asarray(whole * NANOSECONDS + rest_ns, dtype=np.int64)


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
