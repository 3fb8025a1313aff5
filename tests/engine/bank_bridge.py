"""A bridge from physics and its two sensors, for the bank: modes driven by wind, crossing vehicles, slow heating.

Written without `midspan.simulate`: the truth is stepped at 1 kHz, its forces are smooth, and the acceleration is the
second difference of the displacement.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from midspan.engine.bank import Bank, BankBlocks, BankSensor

T0_NS = 1_800_000_000_000_000_000
FAST_HZ, RATE_HZ = 1000, 100


@dataclass(frozen=True)
class Sensors:
    """What the sensors do that nobody has stated: factors on their noise, gain, delay (s), slow error (m, s), bias."""

    acceleration_noise: float = 1.0
    displacement_noise: float = 1.0
    gain: float = 1.0
    delay_s: float = 0.0
    slow_std_m: float = 0.0
    slow_time_s: float = 10.0
    displacement_hz: float = 10.0


@dataclass
class Record:
    """Truth (n,) at the samples, and what the sensors measure."""

    truth_m: np.ndarray
    acceleration: np.ndarray
    displacement_m: np.ndarray
    displacement_hz: float


def markov(count, ratio, rng):
    """Gauss-Markov series of unit deviation; ratio: step over correlation time."""
    keep = np.exp(-ratio)
    noise = rng.standard_normal(count) * np.sqrt(1.0 - keep * keep)
    noise[0] = rng.standard_normal()
    return lfilter([1.0], [1.0, -keep], noise)


def smooth(series, time_s, times):
    """First-order low passes."""
    part = 1.0 / (FAST_HZ * time_s)
    for _ in range(times):
        series = lfilter([part], [1.0, part - 1.0], series)
    return series


def mode(force, hz, damping):
    """Response of x'' + 2ζω x' + ω² x = ω² force."""
    omega, k = 2.0 * np.pi * hz, 2.0 * FAST_HZ
    den = np.array(
        [k * k + 2 * damping * omega * k + omega**2, 2 * (omega**2 - k * k), k * k - 2 * damping * omega * k + omega**2]
    )
    return lfilter(omega**2 * np.array([1.0, 2.0, 1.0]) / den[0], den / den[0], force)


def motion(seconds, seed, rms_m=0.004):
    """Displacement (m) and acceleration (m/s²) of the bridge at 1 kHz."""
    rng, count = np.random.default_rng(seed), int(seconds * FAST_HZ)
    first = rng.uniform(0.5, 2.0)
    x = np.zeros(count)
    for factor, damping, share in ((1.0, 0.01, 1.0), (2.6, 0.01, 0.15), (5.0, 0.015, 0.03)):
        part = mode(smooth(rng.standard_normal(count), 0.02, 3), first * factor, damping)
        x += share * rms_m * part / part.std()
    wind = smooth(markov(count, 1.0 / (2.0 * FAST_HZ), rng), 0.1, 4)
    x += 0.5 * rms_m * wind / wind.std()
    load, at = np.zeros(count), rng.exponential(20.0)
    while at < seconds:
        pulse = 1.0 - np.cos(2.0 * np.pi * np.linspace(0.0, 1.0, int(rng.uniform(4.0, 10.0) * FAST_HZ)))
        begin = int(at * FAST_HZ)
        end = min(count, begin + len(pulse))
        load[begin:end] -= rng.uniform(0.3, 1.0) * rms_m * pulse[: end - begin]
        at += rng.exponential(30.0)
    x += mode(load, first, 0.02)
    x += 0.003 * np.sin(2.0 * np.pi * np.arange(count) / FAST_HZ / 3600.0 + rng.uniform(0.0, 6.28))
    a = np.zeros(count)
    a[1:-1] = (x[2:] - 2.0 * x[1:-1] + x[:-2]) * FAST_HZ**2
    a[0], a[-1] = a[1], a[-2]
    return x, a


def measured(x, a, seed, sensors=None, *, acceleration_std=0.005, displacement_std=0.0015):
    """What the sensors measure of a motion at 1 kHz; gravity and a slow drift are in the acceleration."""
    sensors, rng = sensors or Sensors(), np.random.default_rng(seed + 10_000)
    every = FAST_HZ // RATE_HZ
    samples = sensors.gain * a[::every] + 9.81 + 0.002 * markov(len(a[::every]), 1.0 / (RATE_HZ * 600.0), rng)
    samples += sensors.acceleration_noise * acceleration_std * rng.standard_normal(len(samples))
    at_s = np.arange(0.0, len(x) / FAST_HZ, 1.0 / sensors.displacement_hz)
    y = np.interp(at_s - sensors.delay_s, np.arange(len(x)) / FAST_HZ, x)
    y += sensors.displacement_noise * displacement_std * rng.standard_normal(len(y))
    y += sensors.slow_std_m * markov(len(y), 1.0 / (sensors.displacement_hz * sensors.slow_time_s), rng)
    return Record(x[::every], samples, y, sensors.displacement_hz)


def block(sensor, values, t0_ns, dt_ns, point=0):
    """One block of one point."""
    values = np.asarray(values)
    return BankBlocks(
        sensor,
        np.array([point], dtype=np.uint32),
        np.array([t0_ns], dtype=np.int64),
        np.array([dt_ns], dtype=np.int64),
        np.array([len(values)], dtype=np.uint32),
        values,
    )


def seconds_of(record, point=0, length_s=1):
    """Blocks of both sensors, second by second, with the time when they are there."""
    step, interval = round(1e9 / RATE_HZ), round(1e9 / record.displacement_hz)
    for begin in range(0, len(record.acceleration) // RATE_HZ, length_s):
        t0 = T0_NS + begin * 1_000_000_000
        a = record.acceleration[begin * RATE_HZ : (begin + length_s) * RATE_HZ]
        first, end = (round((begin + k) * record.displacement_hz) for k in (0, length_s))
        yield (
            t0 + length_s * 1_000_000_000,
            [
                block(BankSensor.ACCELERATION, a, t0, step, point),
                block(BankSensor.DISPLACEMENT, record.displacement_m[first:end], t0, interval, point),
            ],
        )


@dataclass
class Table:
    """Rows of one point: index of the sample, displacement, deviation, velocity, status."""

    index: np.ndarray
    displacement_m: np.ndarray
    std_m: np.ndarray
    velocity_m_s: np.ndarray
    status: np.ndarray


def table(parts, point=0):
    """The rows of a point in what `Bank.rows` gave."""
    times, columns = [], [[], [], [], []]
    for rows in parts:
        end = np.cumsum(rows.count)
        for k in np.flatnonzero(rows.point == point):
            part = slice(int(end[k]) - int(rows.count[k]), int(end[k]))
            times.append(rows.t0_ns[k] + rows.dt_ns[k] * np.arange(rows.count[k]))
            status = np.full(rows.count[k], rows.status[k])
            for column, values in zip(
                columns, (rows.displacement_m[part], rows.std_m[part], rows.velocity_m_s[part], status), strict=True
            ):
                column.append(values)
    index = np.rint((np.concatenate(times) - T0_NS) * RATE_HZ / 1e9).astype(int)
    return Table(index, *(np.concatenate(column) for column in columns))


def run(record, settings, wait_s=0):
    """A record through a bank of one point, second by second; its rows and events."""
    bank = Bank(1, settings)
    parts = []
    for now_ns, blocks in seconds_of(record):
        for one in blocks:
            bank.push(one)
        parts.append(bank.rows(now_ns))
    parts.append(bank.rows(now_ns + int(wait_s * 1e9)))
    return table(parts), bank.events()
