"""Which of several places in the image belong to the fixed surroundings: they are tracked and compared."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import MidspanError
from midspan.records import Floats, Frame, PixelTrack, Region, Status
from midspan.vision.search import Span, cut
from midspan.vision.template import TemplateSettings, TemplateTracker
from midspan.vision.texture import gaussian_taps

REPEAT_RANGE_PX = 40
REPEAT_CORRELATION = 0.8  # a second peak above this could be taken for the first in a poorer frame
ENOUGH_TRACKED = 0.7  # share of the frames
ALIKE_PX = 0.1  # fixed targets agree to this, or to a tenth of the motion or five predicted standard deviations
GAIN_RANGE = (0.2, 5.0)  # ratio of the motions in the image of near and far fixed targets


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A place that was tracked: its track (px, from the first frame) and how it agrees with the others.

    quality: median correlation. disagreement_px: rms difference from the common motion. fixed: whether it moves with
    most of the others. verdict: why it was taken or not, in words. displacement_std_m: noise of one frame's
    displacement where an accelerometer gave the scale factor, NaN elsewhere. scale_m_per_px: that factor.
    """

    region: Region
    predicted_std_px: float
    track: PixelTrack
    quality: float
    disagreement_px: float = np.nan
    fixed: bool = False
    verdict: str = ""
    displacement_std_m: float = np.nan
    scale_m_per_px: float = np.nan

    def status_share(self, status: Status) -> float:
        """Share of the frames with this status."""
        return float(np.mean(self.track.status == status))


def repeats(image: NDArray[np.generic], region: Region) -> bool:
    """Whether the region's texture comes again within 40 px, so that one copy could be taken for another."""
    taps = gaussian_taps(0.6).astype(np.float32)
    margin = len(taps) // 2
    rows, columns = image.shape
    whole = Span(margin, columns - region.width - margin, margin, rows - region.height - margin)
    span = whole.around(region.x, region.y, REPEAT_RANGE_PX, REPEAT_RANGE_PX)
    if span.empty:
        return False
    size, offset = (region.height, region.width), float(np.nanmean(np.asarray(image, dtype=np.float64)))
    raw = cut(image, span, size, margin, offset)
    if raw is None:
        return True
    smooth = _core.smooth(raw, taps)
    top, left = min(max(region.y, span.y0), span.y1) - span.y0, min(max(region.x, span.x0), span.x1) - span.x0
    own = smooth[top : top + size[0], left : left + size[1]]
    factor = max(region.width // 48, 1)
    target = _core.shrink(np.ascontiguousarray(own), factor)
    surface = _core.zncc_map(_core.shrink(smooth, factor), (target - target.mean()).astype(np.float32))
    others = [
        p for p in _local_maxima(surface) if max(abs(p[0] * factor - left), abs(p[1] * factor - top)) > 2 * factor
    ]
    return any(surface[y, x] > REPEAT_CORRELATION for x, y in others)


def _local_maxima(surface: Floats) -> list[tuple[int, int]]:
    """Columns and rows of the inner points of `surface` that no neighbour exceeds."""
    inner = surface[1:-1, 1:-1]
    top = np.ones(inner.shape, dtype=np.bool_)
    for dy in range(3):
        for dx in range(3):
            top &= inner >= surface[dy : dy + inner.shape[0], dx : dx + inner.shape[1]]
    return [(int(x) + 1, int(y) + 1) for y, x in zip(*np.nonzero(top), strict=True)]


def track_candidates(frames: Sequence[Frame], places: Sequence[tuple[Region, float]]) -> list[Candidate]:
    """Track each place (region, predicted standard deviation in px); those without a template are left out."""
    out = []
    for region, std_px in places:
        try:
            tracker = TemplateTracker(frames[0], region, TemplateSettings())
        except MidspanError:
            continue
        track = PixelTrack.stack([tracker.push(frame) for frame in frames])
        out.append(Candidate(region, std_px, track, float(np.median(track.quality))))
    return out


def rank_candidates(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Find the motion that most places share; those that follow it come first, by predicted standard deviation."""
    good = [c for c in candidates if c.status_share(Status.TRACKING) >= ENOUGH_TRACKED]
    lost = [replace(c, disagreement_px=np.inf, fixed=False) for c in candidates if c not in good]
    if not good:
        return lost
    tracks = [_path(c) for c in good]
    crowds = [[j for j, t in enumerate(tracks) if disagreement(t, path) <= _limit(path, good[j])] for path in tracks]
    crowd = max(crowds, key=lambda members: _weight([good[j].region for j in members]))
    common = _nanmedian(np.stack([tracks[j] for j in crowd]))
    judged = []
    for candidate, track in zip(good, tracks, strict=True):
        gap = disagreement(track, common)
        judged.append(replace(candidate, disagreement_px=gap, fixed=gap <= _limit(common, candidate)))
    return sorted(judged, key=lambda c: (not c.fixed, c.predicted_std_px / max(c.quality, 0.1) ** 2)) + lost


def _path(candidate: Candidate) -> Floats:
    """The track as (2, n) px."""
    return np.stack([candidate.track.x_px, candidate.track.y_px])


def _limit(common: Floats, candidate: Candidate) -> float:
    """The disagreement (px) up to which a place counts as fixed."""
    motion = float(np.sqrt(np.nanmean(common**2))) if np.isfinite(common).any() else 0.0
    return max(ALIKE_PX, 0.1 * motion, 5.0 * candidate.predicted_std_px)


def _weight(regions: Sequence[Region]) -> float:
    """How much a group of places that move alike counts: by its number, and by its spread over the image.

    The surroundings are everywhere; a vehicle or a tree with as many places on it is compact.
    """
    if not regions:
        return 0.0
    centres = np.array([(r.x, r.y) for r in regions], dtype=np.float64)
    spread = float(np.sqrt(np.sum(np.var(centres, axis=0)))) / max(regions[0].width, regions[0].height)
    return len(regions) * (1.0 + spread)


def _nanmedian(tracks: NDArray[np.float64]) -> Floats:
    """Median over the candidates (first axis); 0 where none of them was seen."""
    seen = np.isfinite(tracks).any(axis=0)
    out = np.zeros(tracks.shape[1:])
    out[seen] = np.nanmedian(np.moveaxis(tracks, 0, -1)[seen], axis=-1)
    return out


def disagreement(track: Floats, common: Floats) -> float:
    """Rms difference (px) of `track` (2, n) from `common` (2, n) times the gain that its distance may give it."""
    seen = np.isfinite(track).all(axis=0) & np.isfinite(common).all(axis=0)
    a, b = track[:, seen], common[:, seen]
    energy = float(np.vdot(b, b))
    gain = float(np.vdot(a, b)) / energy if energy > 0.0 else 1.0
    gain = min(max(gain, GAIN_RANGE[0]), GAIN_RANGE[1])
    return float(np.sqrt(np.mean((a - gain * b) ** 2) * 2.0)) if seen.any() else np.inf
