"""What a key frame says of a frame, made exact by the mix of all pictures, and how well that is known."""

import math
from dataclasses import replace
from statistics import fmean

import numpy as np

from midspan.records import Floats, Frame, PixelTranslation, Status
from midspan.vision.reference.cover import ALL_SEEN, LATELY, PALING, Uncovered, uncovered
from midspan.vision.reference.light import Sight, placed, sight
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.records import place_of, variance_of
from midspan.vision.reference.state import STRENGTH_FRAMES, Appearance, KeyFrameState

SCATTERED = 2.0  # standard deviations of the strength that say nothing
WEAK = 0.95  # share of the usual strength below which a single picture is looked at for a thing in front

Reported = tuple[PixelTranslation, Sight | None]  # a result, and the frame as seen


def measured(
    state: KeyFrameState,
    settings: KeyFrameSettings,
    frame: Frame,
    seen: tuple[int, PixelTranslation],
    *,
    remembered: bool = False,
) -> tuple[Appearance, Reported | None]:
    """How the target looks in `frame`, and its translation since the first frame by the mix of all pictures where there
    is one; None where it is not there.

    seen: the number of a key frame and the translation since that. remembered: that is no more than where the target
    must be; then a mix must find it there. The reference's variance holds those of the key frames' places and of what
    light may do.
    """
    number, found = seen
    if found.status is not Status.TRACKING:
        return state.appearance, None
    key, known = state.keys[number], state.pictures
    own, place = variance_of(found), state.chain.place[number] + place_of(found)
    whole = state.chain.variance(number) + own
    weak = found.strength < WEAK * key.usual
    view, together, looks = _looked_at(state, frame, place, weak=weak, heat=settings.heat)
    exact = None if together is None else together.found
    if (remembered and exact is None) or (together is not None and together.absent):
        return looks, None
    if together is not None:
        looks = replace(looks, hidden=together.hidden, doubtful=together.doubtful)
    mixed = exact is not None and known is not None and known.several
    if exact is not None and known is not None:
        looks = replace(looks, expected=exact.expected)
        if mixed or remembered or looks.hidden.any():
            # What a new picture corrects comes in little by little, not as a step.
            looks = replace(looks, carried=(1.0 - 0.5 / settings.overlap_frames) * looks.carried)
            place, whole = exact.place + looks.carried, known.variance(state.chain, exact) + looks.carried**2
            # What blocks contradict each other by beyond noise stays for many frames, as the places' errors do.
            own = np.minimum(own, exact.variance)
    recent = (found.strength,) if looks.hidden.any() else (*state.health, found.strength)[-STRENGTH_FRAMES:]
    gone = _share_lost(fmean(recent), key.usual)
    whole = whole + settings.light_px**2 * (gone**2 if mixed else _shifted(gone, key.strengths))
    rest = np.maximum(whole - own, 0.0)
    result = replace(
        found,
        x_px=float(place[0]),
        y_px=float(place[1]),
        variance_x_px2=float(own[0]),
        variance_y_px2=float(own[1]),
        reference_variance_x_px2=float(rest[0]),
        reference_variance_y_px2=float(rest[1]),
    )
    return looks, (result, view)


def _looked_at(
    state: KeyFrameState, frame: Frame, place: Floats, *, weak: bool, heat: bool
) -> tuple[Sight | None, Uncovered | None, Appearance]:
    """The frame around the target and where it lies by the pictures; these are not asked without need."""
    known, looks, now_ns = state.pictures, state.appearance, frame.time_ns
    asked = known is not None and (known.several or weak or bool(looks.hidden.any()))
    if not asked:
        looks = replace(looks, lately=(LATELY, now_ns))
    if not asked and state.overlap is None:
        return None, None, looks
    view = sight(frame.pixels, state.keys[0].region, place)
    if known is None or not asked or view is None or looks.expected is None:
        return view, None, looks
    if heat:
        return view, Uncovered(placed(known.mix, view, place), ALL_SEEN, ALL_SEEN), looks
    best, then_ns = looks.lately
    paled = best - PALING * (now_ns - then_ns) / 1e9
    reported = uncovered(known.mix, view, place, (looks.expected, looks.hidden, paled))
    if reported.found is not None and not reported.absent:
        best = np.maximum(paled, np.where(reported.hidden, 1.0, reported.found.agreement))
    return view, reported, replace(looks, lately=(best, now_ns))


def _share_lost(strength: float, usual: float) -> float:
    """Share (0 to 1) of its usual strength that a key frame has lost; 0 while none is usual."""
    if not usual > 0.0:
        return 0.0
    return min(max(1.0 - strength / max(usual, 1e-9), 0.0), 1.0) if math.isfinite(strength) else 1.0


def _shifted(gone: float, strengths: tuple[float, ...]) -> float:
    """Share of strength lost, less its scatter: what goes with the square of a shift, if all of it is shading that
    moves as the target would.
    """
    scatter = SCATTERED * float(np.std(strengths)) / max(fmean(strengths), 1e-12) if len(strengths) > 1 else 0.0
    return max(gone - scatter, 0.0)
