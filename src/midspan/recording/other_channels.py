"""The other channels of the accelerometer's file: whether one of them is the motion that the chosen one only shows."""

import numpy as np

from midspan.errors import MidspanError
from midspan.notices import Notice, rounded
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import calibration_window
from midspan.records import Floats
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.signals.band_pass import band_passed
from midspan.sources.accelerometer.channel import Channel
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import candidates, find_channel
from midspan.sources.accelerometer.units import UPRIGHT_WITHIN, measures, si_factor

# Correlation from which on one channel moves as another does.
ALIKE = 0.8
# Ratio of motions from which on the smaller one may be cross-axis sensitivity, which is 5 % at most; and where the
# larger one reads gravity, which moves up and down in the picture.
CROSS_TALK, BESIDE_GRAVITY = 20.0, 3.0
# The slowest motion compared, Hz, and the values that this takes.
LOW_HZ, MIN_VALUES = 0.3, 100


def other_channels(recording: Recording) -> tuple[Notice, ...]:
    """A warning where another channel has the chosen one's motion many times over; the calibration is wrong by that.

    The scale factor cannot tell: a lens near its object has as few micrometres a pixel as a wrong channel makes of one.
    """
    own = recording.accelerometer
    if own.named_axes or own.cross_values:
        return ()
    try:
        path = recording.path(own.file, "accelerometer.file")
        found = list_channels(path)
    except MidspanError:
        # The acceleration has been put in the file's place.
        return ()
    name = recording.acceleration.name
    if sum(one.size > MIN_VALUES for one in found.channels) < 2 or name not in found.names:
        return ()
    chosen = find_channel(path, found, name, "value")
    others = [one for one in candidates(found, "acceleration") if one.name != name and one.size == chosen.size]
    time_ns, window = recording.acceleration.time_ns, calibration_window(recording)
    part = window if len(time_ns) == chosen.size else slice(None)
    rate_hz = 1e9 * (len(time_ns) - 1) / float(time_ns[-1] - time_ns[0])
    seen = [float(1e9 / np.median(np.diff(times))) for times in recording.frame_times if len(times) > 1]
    band_hz = (LOW_HZ, 0.45 * min([rate_hz, *seen]))
    moved = _motion(chosen, part, rate_hz, band_hz)
    if moved is None:
        return ()
    upright = _reads_gravity(recording, chosen)
    for one in others:
        other = _motion(one, part, rate_hz, band_hz)
        if other is None or not measures(one.unit or own.unit, "acceleration") or one.unit != chosen.unit:
            continue
        ratio = float(np.std(other) / np.std(moved))
        gravity = not upright and _reads_gravity(recording, one)
        least = BESIDE_GRAVITY if gravity and recording.axis == "y" else CROSS_TALK
        # A column without a unit may be the displacement.
        if (gravity or one.unit) and ratio > least and abs(np.corrcoef(moved, other)[0, 1]) > ALIKE:
            text = (
                f"accelerometer: channel {one.name!r} has {rounded(ratio)} times the motion of {name!r}"
                f"{' and carries gravity' if gravity else ''}; the camera may see that. Check accelerometer.value: all "
                "displacements may be as many times too small."
            )
            return (Notice("channel-doubtful", text),)
    return ()


def _motion(channel: Channel, part: slice, rate_hz: float, band_hz: tuple[float, float]) -> Floats | None:
    """What of a channel's window lies in a band; None where it does not move, or has gaps."""
    values = np.asarray(channel.values[part], dtype=np.float64)
    if len(values) < MIN_VALUES or not np.isfinite(values).all() or band_hz[1] <= band_hz[0]:
        return None
    moved = band_passed(values - values.mean(), rate_hz, band_hz)
    return moved if np.std(moved) > 0.0 else None


def _reads_gravity(recording: Recording, channel: Channel) -> bool:
    """Whether the mean of a channel is that of an axis upright."""
    unit = recording.accelerometer.unit or channel.unit
    if not measures(unit, "acceleration"):
        return False
    mean = float(np.nanmean(channel.values)) * si_factor(str(unit), "acceleration", None)
    return abs(abs(mean) / GRAVITY_M_S2 - 1.0) < UPRIGHT_WITHIN
