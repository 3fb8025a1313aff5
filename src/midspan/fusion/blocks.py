"""Records to the arrays that the loop takes, and back: measurements, samples, the beginning, rows, innovations."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.filtering import (
    FOUND_SOURCE,
    FOUND_STATUS,
    FOUND_VARIANCE,
    FOUND_VELOCITY,
    FOUND_X,
    MET_CODE,
    MET_ERROR,
    MET_TOTAL,
)
from midspan.fusion.forward import (
    AT,
    CHANNEL,
    MEASUREMENT_COLUMNS,
    REFERENCE,
    SET_DATUM,
    VALUE,
    VARIANCE,
    WENT_BACK,
)
from midspan.fusion.hypothesis import KINDS, LOST, OUTLIER
from midspan.fusion.model import Beginning, EstimatorSettings
from midspan.records import (
    NANOSECONDS,
    Channel,
    Estimate,
    Floats,
    Innovation,
    Measured,
    SampleKind,
    Samples,
    Status,
    joined,
    nanoseconds,
    part,
    seconds,
)

# The motion's first velocity lies within three times what the sensors say of its size; acceleration is taken to belong
# to a motion of no less than 0.2 Hz. Of the steps of a channel's first measurements this share is sound.
VELOCITY_WITHIN, SLOWEST_HZ, SOUND_SHARE = 3.0, 0.2, 0.25
# The structure lies within so many times what the first measurements of the only channel scatter by, or within so many
# metres where they are fewer than these. A wider prior would make each measurement unlikely that begins it anew: of
# two, the farther off the first one is, the more likely would the first one be.
SCATTER_WITHIN, FARTHEST_M, FEW = 3.0, 1.0, 4
# What became of a measurement, in its innovation.
ACCEPTED, REJECTED, REACQUIRED = 0, 1, 2
# By what the measurement was taken for.
VERDICTS = np.full(KINDS, ACCEPTED, dtype=np.int8)
VERDICTS[[OUTLIER, LOST]] = REJECTED, REACQUIRED
NO_INNOVATION = Innovation(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0, dtype=np.int8))
# Comparing arrays with members of an enumeration is slow.
BRIDGED, INSERTED, COASTING = int(SampleKind.BRIDGED), int(SampleKind.INSERTED), float(Status.COASTING)


def measured_rows(record: Measured, units_per_m: Floats, origin_ns: int) -> Floats:
    """Rows (m, 5) of the usable measurements as the loop takes them; units_per_m (c,): of all channels."""
    rows = np.empty((len(record.time_ns), MEASUREMENT_COLUMNS))
    rows[:, AT], rows[:, CHANNEL] = seconds(record.time_ns, origin_ns), record.channel
    rows[:, VALUE], rows[:, VARIANCE] = record.value, record.variance
    reference = np.where(np.isfinite(record.reference_variance), record.reference_variance, 0.0)
    rows[:, REFERENCE] = reference / units_per_m[record.channel] ** 2
    usable = np.isfinite(record.value) & (record.variance > 0.0) & (record.variance < np.inf)
    return rows if usable.all() else rows[usable]


def in_order(rows: Floats) -> Floats:
    """Measurements in time order; of one instant by channel."""
    ordered = (rows[1:, AT] > rows[:-1, AT]).all()
    return rows if ordered else rows[np.lexsort((rows[:, CHANNEL], rows[:, AT]))]


def newest(rows: Floats, most: int) -> Floats:
    """At most so many measurements, the newest of those in time order; of the marks before them the last of each kind
    stays, as they hold from their instant on.
    """
    if len(rows) <= most:
        return rows
    measured = np.flatnonzero(rows[:, CHANNEL] >= 0.0)
    first = int(measured[-most]) if len(measured) > most else 0
    kept = np.arange(len(rows)) >= first
    for mark in (SET_DATUM, WENT_BACK):
        kept[np.flatnonzero(rows[:first, CHANNEL] == mark)[-1:]] = True
    return rows[kept]


def sample_rows(samples: Samples, origin_ns: int) -> Floats:
    """Rows (s, 1 + 2 axes) of time in s, acceleration and noise density as the loop takes them."""
    count, axes = samples.value_m_s2.shape
    rows = np.empty((count, 1 + 2 * axes))
    rows[:, 0] = seconds(samples.time_ns, origin_ns)
    rows[:, 1 : 1 + axes], rows[:, 1 + axes :] = samples.value_m_s2, samples.noise_density
    return rows


def with_start(samples: Samples, first_s: float, origin_ns: int) -> Samples:
    """Put a sample before the first one where a measurement comes before it: the zero may belong to that.

    What the acceleration was until the first sample is not known: its noise is what it varies by later.
    """
    start_ns, first_ns = int(samples.time_ns[0]), origin_ns + round(first_s * NANOSECONDS)
    if first_ns >= start_ns:
        return samples
    # A whole interval at least: over nanoseconds the step to the first sample would be an endless slope.
    first_ns = min(
        first_ns, start_ns - int(np.median(np.diff(samples.time_ns))) if len(samples.time_ns) > 1 else first_ns
    )
    value = np.mean(samples.value_m_s2[:100], axis=0, keepdims=True)
    unknown = np.var(samples.value_m_s2[:100], axis=0) / SLOWEST_HZ
    density = samples.noise_density.copy()
    density[0] += unknown
    before = Samples(np.array([first_ns]), value, density[:1], np.array([SampleKind.INSERTED], dtype=np.uint8))
    return joined([before, replace(samples, noise_density=density)])


def beginning(samples: Floats, rows: Floats, settings: EstimatorSettings) -> Beginning:
    """The state before the first sample, from the first samples (s, 1 + 2 axes) and measurements (m, 5)."""
    place, within, speed = np.zeros(settings.axes), np.full(settings.axes, FARTHEST_M), np.zeros(settings.axes)
    number = rows[:, CHANNEL].astype(np.int64)
    per_m = np.array([channel.units_per_m for channel in settings.channels])[number]
    value_m, std_m = rows[:, VALUE] / per_m, np.sqrt(rows[:, VARIANCE]) / np.abs(per_m)
    for a in range(settings.axes):
        speed[a] = moving(float(np.std(samples[:, 1 + a])), settings.motion[a])
        along = [c for c in np.unique(number).tolist() if settings.channels[c].axis == a]
        if along:
            own = np.isin(number, along)
            place[a] = np.median(value_m[own & (rows[:, AT] == rows[own, AT][0])])
        for c in along:
            time_s, met_m = rows[number == c, AT], value_m[number == c]
            steps = np.abs(np.diff(met_m)) / np.maximum(np.diff(time_s), 1e-3)
            speed[a] = max(speed[a], np.quantile(steps, SOUND_SHARE)) if len(steps) else speed[a]
            if len(along) == 1 and len(met_m) >= FEW:
                within[a] = SCATTER_WITHIN * (np.ptp(met_m) + np.max(std_m[number == c]))
    speed *= VELOCITY_WITHIN
    # The first measurement may come some time after the zero, from which on the state is followed.
    within += speed * max(float(rows[0, AT] - samples[0, 0]), 0.0)
    if settings.displacement_std_m is not None:
        within[:] = settings.displacement_std_m
    if settings.velocity_std_m_s is not None:
        speed[:] = settings.velocity_std_m_s[: settings.axes]
    return Beginning(float(samples[0, 0]), samples[0, 1 : 1 + settings.axes], place, within, speed, len(rows))


def moving(felt: float, motion: tuple[float, float]) -> float:
    """Velocity (m/s) of a motion whose acceleration is `felt` (m/s²), by what is known of it: `EstimatorSettings`.

    Its mean square is no more than those of displacement and acceleration allow.
    """
    moved, rate = motion
    return float(np.sqrt(moved * max(moved * rate * rate, felt))) if moved > 0.0 else felt / (2.0 * np.pi * SLOWEST_HZ)


def given_rows(samples: Samples, first_s: float, origin_ns: int) -> NDArray[np.bool_]:
    """Samples (s,) that are rows: from the first measurement on, and not inserted ones."""
    first_ns = origin_ns + round(first_s * NANOSECONDS)
    given: NDArray[np.bool_] = (samples.time_ns >= first_ns) & (samples.kind != INSERTED)
    return given


def estimate_of(samples: Samples, found: Floats, given: NDArray[np.bool_], unseen_m2: float) -> Estimate:
    """The rows of one axis from what the loop found (s, 5); bridged samples are coasting at best.

    unseen_m2: see `EstimatorSettings.unseen_variance_m2`.
    """
    if not given.all():
        samples, found = part(samples, given), found[given]
    status = found[:, FOUND_STATUS]
    if samples.kind.any():
        status = np.where(samples.kind == BRIDGED, np.maximum(status, COASTING), status)
    return Estimate(
        samples.time_ns,
        found[:, FOUND_X].copy(),
        found[:, FOUND_VARIANCE] + unseen_m2,
        found[:, FOUND_VELOCITY].copy(),
        found[:, FOUND_SOURCE].astype(np.uint8),
        status.astype(np.uint8),
    )


def innovations_of(rows: Floats, met: Floats, channels: Sequence[Channel], origin_ns: int) -> tuple[Innovation, ...]:
    """Innovations of each channel, in metres, from the measurements (m, 5) and how they were met (m, 3)."""
    if not len(rows):
        return (NO_INNOVATION,) * len(channels)
    time_ns, number = nanoseconds(rows[:, AT], origin_ns), rows[:, CHANNEL]
    verdict = VERDICTS[met[:, MET_CODE].astype(np.int64) % KINDS]
    found = []
    for c, channel in enumerate(channels):
        own = np.flatnonzero(number == c)
        error, total = met[own, MET_ERROR] / channel.units_per_m, met[own, MET_TOTAL] / channel.units_per_m**2
        found.append(Innovation(time_ns[own], error, total, verdict[own]))
    return tuple(found)
