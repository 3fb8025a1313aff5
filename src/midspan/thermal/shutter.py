"""Flat-field corrections: moments at which a thermal camera closes its shutter to level its pixels.

For some tenths of a second the picture is frozen or shows the shutter, and afterwards level and fixed pattern are
others. Such frames must not be tracked: a frozen one says that the structure is static.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.records import NANOSECONDS, Event, Floats, Frame

_STEP_FACTOR = 8.0  # times the usual change of the level from frame to frame
_LEARNING = 0.05  # weight of a frame in what is usual
_RISING_S = 30.0  # time constant by which the usual contrast rises: a body that passes does not become usual
_TAILS = 2.44  # from 5 to 95 % it is this many times as far as from quartile to quartile of a normal variable
_QUARTER = 25.0  # percent: from quartile to quartile, what covers less than a quarter of the picture changes it little
_MIN_FRAMES = 2  # frozen frames that make an event: a recorder may write one picture twice
# Contrast below this share of the usual one is the shutter's.
FLAT_SHARE = 0.35
MIN_STEP_K = 0.15  # smallest jump of the mean level from one frame to the next that is reported
MAX_CLOSED_S = 3.0  # what lasts longer is no shutter but another scene


@dataclass(frozen=True, slots=True, eq=False)
class ShutterState:
    """What is remembered: the last picture (every this many pixels) and its time, the usual contrast and step of the
    level in K, and the running segment of closed frames: how many, since when, and whether they were frozen.
    """

    last: Floats | None = None
    last_ns: int = 0
    contrast_k: float = 0.0
    usual_step_k: float = 0.0
    closed: int = 0
    since_ns: int = 0
    frozen: bool = False


@dataclass(frozen=True, slots=True)
class ShutterVerdict:
    """Whether a frame may be tracked; `reopened`: the first one after the shutter, with another fixed pattern; `step_k`
    by how much the level has jumped (0: not at all); and what is worth reporting.
    """

    usable: bool
    reopened: bool = False
    step_k: float = 0.0
    events: tuple[Event, ...] = ()


class ShutterWatch:
    """Tells frames that were taken with the shutter closed."""

    def __init__(self) -> None:
        # Everything that changes from frame to frame.
        self.state = ShutterState()

    def restore(self, state: ShutterState) -> None:
        """Continue from a `state` taken earlier."""
        self.state = state

    def push(self, frame: Frame) -> ShutterVerdict:
        """Judge a frame (rows, columns) in °C; frames come in the order of their times."""
        # Some thousand pixels of the picture show it as well as all.
        step = max(min(frame.pixels.shape) // 60, 1)
        thinned = np.asarray(frame.pixels[::step, ::step], dtype=np.float64)
        state, now = self.state, np.where(np.isfinite(thinned), thinned, 0.0)
        if state.last is None:
            self.state = replace(state, last=now, last_ns=frame.time_ns, contrast_k=_spread(now, _QUARTER))
            return ShutterVerdict(True)
        frozen = bool(np.array_equal(now, state.last))
        since = state.since_ns if state.closed else frame.time_ns
        long = frame.time_ns - since > MAX_CLOSED_S * NANOSECONDS
        # A warm body that leaves takes contrast away too, but never all that there is between 5 and 95 %.
        if frozen or (not long and _spread(now, 5.0) / _TAILS < FLAT_SHARE * state.contrast_k):
            self.state = replace(state, closed=state.closed + 1, since_ns=since, frozen=frozen)
            return ShutterVerdict(False)
        return self._open(frame, now)

    def _open(self, frame: Frame, now: Floats) -> ShutterVerdict:
        state = self.state
        assert state.last is not None
        change = float(np.median(now - state.last))
        limit = max(MIN_STEP_K, _STEP_FACTOR * state.usual_step_k)
        # A recorder that writes pictures twice freezes single frames; the shutter needs longer.
        reopened = state.closed >= _MIN_FRAMES or (state.closed > 0 and not state.frozen)
        stepped = abs(change) > limit
        usual = state.usual_step_k
        if not (stepped or reopened):
            usual += _LEARNING * (abs(change) - usual)
        contrast = self._usual_contrast(frame, _spread(now, _QUARTER))
        self.state = ShutterState(now, frame.time_ns, contrast, usual)
        reported = []
        if reopened:
            text = (
                f"the thermal camera's shutter was closed for {(frame.time_ns - state.since_ns) / NANOSECONDS:.2f} s "
                f"({state.closed} frames); its level changed by {change:+.2f} K"
            )
            reported.append(Event(state.since_ns, "shutter", text))
        elif stepped:
            reported.append(Event(frame.time_ns, "level-step", f"the thermal camera's level jumped by {change:+.2f} K"))
        step = change if stepped or reopened else 0.0
        return ShutterVerdict(True, reopened, step, tuple(reported))

    def _usual_contrast(self, frame: Frame, now_k: float) -> float:
        """The usual contrast (K) after a frame of `now_k`: falls quickly, rises slowly, is new in a new scene."""
        state = self.state
        if state.closed and frame.time_ns - state.since_ns > MAX_CLOSED_S * NANOSECONDS:
            return now_k
        usual = state.contrast_k
        if now_k < usual:
            return usual + _LEARNING * (now_k - usual)
        elapsed_s = max(frame.time_ns - state.last_ns, 0) / NANOSECONDS
        return usual + (1.0 - float(np.exp(-elapsed_s / _RISING_S))) * (min(now_k, 2.0 * usual) - usual)


def _spread(values: Floats, percent: float) -> float:
    low, high = np.percentile(values, (percent, 100.0 - percent))
    return float(high - low)
