"""Raw ADC captures of TI's mmWave radars with the DCA1000 card, streamed frame by frame."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError, UsageError
from midspan.notices import Notice
from midspan.radar.chirp import RadarInfo
from midspan.radar.iq_order import MIN_DB, decide_order, swapped, weigh_orders
from midspan.radar.layout import WORD_BYTES, Layout, Words, block_words, sign_extended, unpack
from midspan.radar.range_profile import averaged, range_profile, slow_time, whole_channels
from midspan.records import ChirpFrame, Floats, Nanoseconds, RangeFrames
from midspan.sources.radar.capture_bytes import Bytes, CaptureBytes, missing_files, open_bytes
from midspan.sources.radar.radar_source import RadarRequest, RadarSource, stamps
from midspan.sources.radar.ti_config import TiSettings, read_settings

PROBED_FRAMES = 64
# Zeros after the last frame are looked at up to this many bytes.
MAX_PADDING = 1 << 24
# Missing at the end up to this many frames, or this share, are not worth a warning: a capture is stopped by hand.
FEW_FRAMES, FEW_SHARE = 2, 0.01
# Frames of another number of samples, receivers or chirps differ in size by a ratio of whole numbers up to this.
SIMPLE_RATIO = 64
# The share of samples at the limits of the ADC from which a capture is useless, and from which it is reported.
SATURATED, NEARLY_SATURATED = 0.01, 1e-5
# Every this many groups of four words are looked at for a hole; a lost packet holds 182 of them.
_STRIDE, _FEW = 8, 2
_GROUP = 4


class RawCapture(RadarSource):
    """Frames of a `.bin`; what was lost is shown by `valid`, never taken for data."""

    file_kind, at_a_time = "raw ADC data", 256

    def __init__(self, path: Path, request: RadarRequest) -> None:
        super().__init__(path, request)
        if request.config is None:
            raise UsageError(
                f"{path.name} is raw ADC data and needs radar.config, the .cfg or .json it was recorded with; without "
                "it the frames have no size and the phase no scale."
            )
        settings = read_settings(request.config)
        self._layout = layout = settings.layout(request.config)
        self._bytes = open_bytes(path)
        self._count, notes = _frame_count(path, self._bytes, settings, layout)
        missing = _missing(path, self._count, settings)
        self._runs = True
        probe = self._probe()
        if not probe.size:
            # A very quiet converter makes zeros of its own: then only whole chirps of zeros are holes.
            self._runs = False
            probe = self._probe()
        share = _check_levels(path, probe, layout)
        self._layout, order_notes, warnings = _ordered(path, probe, layout, settings, request.iq_order)
        notes += (*self._bytes.notes, *settings.notes, *order_notes)
        if share > NEARLY_SATURATED:
            notes += (f"{100 * share:.3f} % of the samples are at the limits of the ADC",)
        self._notes, self._warnings = notes, (*missing, *self._bytes.warnings, *warnings)
        self._missing = 0

    @property
    def layout(self) -> Layout:
        """The cube's axes and the order of its words."""
        return self._layout

    @property
    def info(self) -> RadarInfo:
        """Settings, size, order of I and Q; `missing_frames` counts those read by now."""
        profile = self._layout.profile
        return RadarInfo(
            kind=f"raw ADC, {profile.chirps} chirps × {profile.receivers} receivers × {profile.samples} samples",
            carrier_hz=profile.carrier_hz,
            frame_rate_hz=profile.frame_rate_hz,
            frame_count=self._count,
            channels=profile.receivers * len(set(profile.transmitters)),
            range_m=profile.axis.range_m,
            iq_order=self._layout.order if profile.complex_samples else "real",
            profile=profile,
            missing_frames=self._missing,
            notes=self._notes,
            warnings=self._warnings,
        )

    def times_ns(self) -> Nanoseconds:
        """The middle of each frame's chirps, evenly spaced from `start_s`."""
        profile = self._layout.profile
        first = self._request.start_s + profile.middle_s
        times_s = np.asarray(first + np.arange(self._count) * profile.frame_period_s, dtype=np.float64)
        return stamps(self._path, times_s, 0.0)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[ChirpFrame]:
        """Single frames with all their samples."""
        times = self.times_ns()
        for first, words, valid in self.guarded(self._blocks(start, stop)):
            for k, cube in enumerate(unpack(words, self._layout)):
                yield ChirpFrame(int(times[first + k]), cube, valid[k], first + k)

    def _profiles(self, start: int, stop: int | None) -> Iterator[RangeFrames]:
        """Whole range profiles, chirps of the same transmitters averaged."""
        times, profile = self.times_ns(), self._layout.profile
        for first, words, valid in self._blocks(start, stop):
            block = averaged(range_profile(unpack(words, self._layout), profile), profile)
            yield RangeFrames(times[first : first + len(block)], block, whole_channels(valid, profile))

    def _slow_time(self, bins: Floats, start: int, stop: int | None) -> Iterator[RangeFrames]:
        """Only the wanted bins, straight from the stored words."""
        times, profile = self.times_ns(), self._layout.profile
        for first, words, valid in self._blocks(start, stop):
            block = slow_time(words, self._layout, bins)
            yield RangeFrames(times[first : first + len(block)], block, whole_channels(valid, profile))

    def words(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[Words, NDArray[np.bool_]]]:
        """Raw words (frames · words a frame,) in blocks, and which channels (frames, channels) are whole."""
        for _, words, valid in self.guarded(self._blocks(start, stop)):
            yield words, whole_channels(valid, self._layout.profile)

    def _blocks(self, start: int, stop: int | None) -> Iterator[tuple[int, Words, NDArray[np.bool_]]]:
        """First frame, words and valid (frames, chirps, receivers) of each block."""
        size = self._layout.frame_bytes
        begin, end, _ = slice(start, stop).indices(self._count)
        for first in range(begin, end, self.at_a_time):
            count = min(self.at_a_time, end - first)
            words, holes = self._read(first * size, count * size)
            valid = ~holes
            self._missing += int(np.count_nonzero(~valid.all(axis=(1, 2))))
            yield first, words, valid

    def _probe(self) -> Words:
        """Words of up to 64 frames spread over the capture, those with holes left out where others are left."""
        size = self._layout.frame_bytes
        wanted = np.unique(np.linspace(0, self._count - 1, min(PROBED_FRAMES, self._count)).astype(np.int64))
        parts = []
        for frame in wanted:
            words, holes = self._read(int(frame) * size, size)
            if not holes.any():
                parts.append(words)
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int16)

    def _read(self, start: int, count: int) -> tuple[Words, NDArray[np.bool_]]:
        """Words of the bytes from `start` on, and which receivers' chirps have a hole in them."""
        data, missing = self._bytes.read(start, count)
        words = np.ascontiguousarray(data).view("<i2")
        return words, _holes(words, missing, self._layout, runs=self._runs)


def _frame_count(path: Path, data: CaptureBytes, settings: TiSettings, layout: Layout) -> tuple[int, tuple[str, ...]]:
    """Whole frames in the capture and what is to be said; DataError where settings and size do not fit."""
    each, said, size = layout.frame_bytes, settings.frames, data.size
    sums = f"The settings make {layout.arithmetic()}"
    if size < each:
        raise DataError(f"{path} holds {size} bytes, less than one frame. {sums}. Check radar.config and the capture.")
    whole, rest = divmod(size, each)
    if said and size > said * each and not data.read(said * each, min(size - said * each, MAX_PADDING))[0].any():
        return said, (f"{size - said * each} bytes of zeros after the last frame are left out",)
    # A file that is too short may hold as many frames as it should, of another size in a simple ratio.
    is_short = said and size < said * each and size % said == 0
    is_other = is_short and Fraction(size // said, each).denominator <= SIMPLE_RATIO
    if said and (size > said * each or (is_other and not missing_files(path))):
        raise DataError(
            f"{path} does not fit radar.config. {sums}, {said} frames are {said * each} bytes; found are {size} bytes, "
            f"{size / said:.10g} bytes a frame. Give the settings that it was recorded with."
        )
    notes = []
    if said and whole < said:
        notes.append(f"{whole} of {said} frames are there")
    if rest:
        notes.append(f"the last frame is cut off: {rest} of {each} bytes, left out")
    return whole, tuple(notes)


def _missing(path: Path, count: int, settings: TiSettings) -> tuple[Notice, ...]:
    """Sentences on files of a split capture, and on frames of the settings, that are not there."""
    absent, texts = missing_files(path), []
    if absent:
        texts.append(
            f"radar: {', '.join(absent)} is missing next to {path.name}, but later files exist: the capture is read "
            "only up to the gap. Restore the file."
        )
    if settings.frames - count > max(FEW_FRAMES, FEW_SHARE * settings.frames):
        texts.append(
            f"radar: {path.name} has {count} of the {settings.frames} frames that radar.config declares; the result "
            "ends with them. Check that the capture is complete."
        )
    return tuple(Notice("radar-data", text) for text in texts)


def _check_levels(path: Path, probe: Words, layout: Layout) -> float:
    """The share of the samples that are at the limits of the ADC; DataError where they cannot be a radar's."""
    if not probe.any():
        raise DataError(
            f"{path} has only zeros (or holes) in up to {PROBED_FRAMES} frames of {layout.frame_bytes} bytes. Check "
            "that the radar was started before the capture, and its cable."
        )
    rows = probe.reshape(-1, layout.frame_words)
    if len(rows) > 1 and (rows == rows[0]).all():
        raise DataError(
            f"{path} has the same samples in all {len(rows)} frames that were checked, without any noise: no radar "
            "measured them. Check radar.file and the capture."
        )
    highest = 2 ** (layout.profile.bits - 1)
    samples = sign_extended(probe, layout.profile.bits)
    share = float(np.count_nonzero((samples >= highest - 1) | (samples <= 1 - highest)) / samples.size)
    if share > SATURATED:
        raise DataError(
            f"{path} is saturated: {100 * share:.1f} % of {probe.size} samples checked are at the limits of the ADC "
            f"(−{highest}, {highest - 1}); at most {100 * SATURATED:g} % can be used. Lower the receiver gain, or "
            "move the radar away from near reflectors."
        )
    return share


def _ordered(
    path: Path, probe: Words, layout: Layout, settings: TiSettings, wanted: str
) -> tuple[Layout, tuple[str, ...], tuple[Notice, ...]]:
    """The layout with its order of I and Q, notes and warnings."""
    if not layout.profile.complex_samples:
        return layout, (), ()
    evidence = weigh_orders(probe, layout)
    if wanted == "auto":
        decision = decide_order(evidence, settings.order, said=settings.order_said)
        reported = (decision.text,)
        notices = () if decision.certain else (Notice("radar-data", decision.text),)
        return replace(layout, order=decision.order), reported if decision.certain else (), notices
    chosen = replace(layout, order=wanted)
    if layout.lanes == 4 and wanted not in evidence.halves_db:
        chosen = replace(layout, order="IIQQ" if wanted[0] == "I" else "QQII")
    pair = evidence.paired()
    better = swapped(chosen.order) if evidence.proves(swapped(chosen.order)) else ""
    if pair is not None and chosen.order not in pair:
        better = max(pair, key=lambda order: evidence.halves_db[order])
    if better:
        raise DataError(
            f"{path}: radar.iq_order = {wanted!r} does not fit the samples. Energy of the nearer over the farther half "
            f"of the range: {evidence.reported()}. Set radar.iq_order to {better!r}, or leave it out."
        )
    if evidence.halves_db[chosen.order] < MIN_DB:
        return chosen, (), (Notice("radar-data", decide_order(evidence, chosen.order, said=True).text),)
    return chosen, (f"I/Q order {wanted} as given ({evidence.reported()})",), ()


def _holes(words: Words, missing: Bytes | None, layout: Layout, *, runs: bool) -> NDArray[np.bool_]:
    """Which receivers' chirps (frames, chirps, receivers) have a hole in them."""
    # Where it is not known which bytes were received, a hole shows as a run of zeros, which noise never makes.
    profile = layout.profile
    length = block_words(layout)
    if missing is not None:
        lost = missing.reshape(-1, length * WORD_BYTES).any(axis=1)
    elif runs:
        lost = _zero_runs(words, length)
    else:
        lost = ~words.reshape(-1, length).any(axis=1)
    if layout.lanes == 4:
        return np.repeat(lost.reshape(-1, profile.chirps, 1), profile.receivers, axis=2)
    return lost.reshape(-1, profile.chirps, layout.stored)


def _zero_runs(words: Words, length: int) -> NDArray[np.bool_]:
    """Which blocks of `length` words hold a run of zeros, or the end of one that is in the block before or after."""
    if length % _GROUP:
        return np.asarray(~words.reshape(-1, length).any(axis=1))
    groups = words.view(np.int64).reshape(-1, length // _GROUP)
    zero = groups[:, ::_STRIDE] == 0
    if not zero.any():
        # As good as always, and much faster than to count.
        return np.zeros(len(groups), dtype=np.bool_)
    thin = np.count_nonzero(zero, axis=1)
    few = min(_FEW, max(1, groups.shape[1] // _STRIDE))
    lost = np.asarray(thin >= few)
    if lost.any():
        begins, ends = groups[:, 0] == 0, groups[:, -1] == 0
        before, after = np.append(False, lost[:-1]), np.append(lost[1:], False)
        lost = lost | (begins & before) | (ends & after)
    return lost
