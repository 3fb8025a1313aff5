"""When a key frame is made and when an earlier one is tried: settings and decisions, which change nothing."""

import math
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

from midspan.checks import option, refuse
from midspan.records import Floats, Frame, Prediction, Region
from midspan.vision.reference.cover import likeness
from midspan.vision.reference.light import Sight, inside
from midspan.vision.reference.pictures import MIN_SHOWN_SHARE
from midspan.vision.reference.records import contrast
from midspan.vision.reference.state import MIN_PAIRS, KeyFrameState
from midspan.vision.tracker import TRACKERS

NEAR_PX = 1.5  # of where the target must be: what a key frame finds beyond is another thing
FAR_SHARE = 0.25  # of the region's side: how far from its last place a target without prediction is believed
ANYWHERE_TURNS = 20  # every this many tries the first frame is looked for everywhere
CLEARER = 1.5  # times the contrast of a key frame that is mostly noise: time for another
MIN_SEEN_SHARE = 0.35  # share of the target that must be seen to learn from it


@dataclass(frozen=True, slots=True)
class KeyFrameSettings:
    """How key frames are made and used.

    tracker, tracker_settings: what tracks, its own settings. renew_share: a new key frame begins when the strength
    (matches, or quality) falls below this share of the usual one, 0 to 1; more gives more key frames. return_share: an
    earlier one is taken again above this share. overlap_frames: frames that make a key frame's picture and the
    hand-over to it, 3 or more. try_every: every this many frames an earlier key frame is tried. related: this many
    earlier ones are tried when the one in use is lost, 1 or more. most: key frames kept, 3 or more; memory and time are
    limited by it. link_floor_px: standard deviation of a key frame's place that nothing takes away. light_px: standard
    deviation that the loss of all strength stands for, px. unmixed_px: standard deviation of a picture's place if
    nothing in it were a mix of others: what the shadows do that bumps throw in grazing light is a quarter of 3 px.
    heat: frames are temperatures: bright and dark may change places, and things in front, which were taken out
    before, are not looked for.
    """

    tracker: str = "template"
    tracker_settings: Any = None
    renew_share: float = 0.9
    return_share: float = 0.95
    overlap_frames: int = 10
    try_every: int = 5
    related: int = 3
    most: int = 24
    link_floor_px: float = 0.005
    light_px: float = 0.6
    unmixed_px: float = 3.0
    heat: bool = False

    def __post_init__(self) -> None:
        option("tracker", self.tracker, TRACKERS)
        if not 0.0 < self.renew_share < self.return_share <= 1.0:
            raise refuse(
                "renew_share and return_share", "above 0, rising, up to 1", (self.renew_share, self.return_share)
            )
        for name, least in (("overlap_frames", MIN_PAIRS), ("try_every", 1), ("related", 1), ("most", 3)):
            if getattr(self, name) < least:
                raise refuse(name, f"{least} or more", getattr(self, name))
        if not (0.0 <= self.link_floor_px < math.inf and 0.0 <= self.light_px < math.inf):
            raise refuse("link_floor_px and light_px", "0 px or more", (self.link_floor_px, self.light_px))
        if not 0.0 <= self.unmixed_px < math.inf:
            raise refuse("unmixed_px", "0 px or more", self.unmixed_px)


def near(place: Floats, prediction: Prediction | None, state: KeyFrameState) -> bool:
    """Whether a place (2,) px is where the target can be, by the prediction or else by where it was last seen."""
    if prediction is None:
        before, region = np.zeros(2) if state.last is None else state.last[1], state.keys[0].region
        return float(np.abs(place - before).max()) <= FAR_SHARE * min(region.width, region.height)
    off = np.abs(place - np.array([prediction.x_px, prediction.y_px]))
    return bool((off <= 3.0 * np.array([prediction.std_x_px, prediction.std_y_px]) + NEAR_PX).all())


def paled(
    state: KeyFrameState, renew_share: float, view: Sight | None, place: Floats, *, cleared: bool
) -> tuple[bool, float]:
    """Whether light has changed the target: by the strength or, where something stands in front, by the rest; and the
    likeness to remember. cleared: it stands out better than in the key frame.
    """
    usual, known, looks = state.key.usual, state.pictures, state.appearance
    share = fmean(state.health) / usual if state.health and usual > 0.0 else 1.0
    if not looks.hidden.any() or known is None:
        return share < renew_share or cleared, 0.0
    window = None if view is None else view.window(place)
    if window is None or np.mean(~looks.hidden) < MIN_SEEN_SHARE or np.mean(~looks.doubtful) < MIN_SHOWN_SHARE:
        return False, state.likeness
    alike, before = likeness(known.mix, inside(window), looks.doubtful), state.likeness
    if before == 0.0:
        before = min(alike / max(share, renew_share), 1.0)
    elif before < 0.0:
        before = alike
    # The middle cell loses three quarters of what the whole loses.
    return alike < (1.0 - 0.75 * (1.0 - renew_share)) * before, before


def cleared(state: KeyFrameState, frame: Frame, region_now: Region) -> bool:
    """Whether the target stands out much better than in the key frame, which is mostly noise."""
    return not state.key.clear and contrast(frame, region_now) > CLEARER * state.key.contrast


def to_try(state: KeyFrameState, settings: KeyFrameSettings) -> tuple[int, bool] | None:
    """The earlier key frame whose turn it is, and whether it is looked for everywhere; None: it cannot help."""
    turn = state.frames // settings.try_every
    anywhere = turn % ANYWHERE_TURNS == 0
    # Every other try is for the first frame, the rest for the others in turn.
    number = 0 if turn % 2 == 0 else (turn // 2) % len(state.keys)
    if state.keys[number].hidden.any() or (_unlike(state, number, settings.renew_share) and not anywhere):
        return None
    better = state.chain.variance(number).sum() < state.chain.variance(state.current).sum()
    return (number, anywhere) if better else None


def _unlike(state: KeyFrameState, number: int, renew_share: float) -> bool:
    """Whether a key frame's picture shows that it cannot match again."""
    known, expected = state.pictures, state.appearance.expected
    if known is None or expected is None or number not in known.numbers:
        return False
    picture = known.mix.pictures[known.numbers.index(number)]
    return float(picture @ expected) < renew_share * float(np.linalg.norm(expected))
