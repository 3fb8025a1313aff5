"""Records with known truth for the estimator: oscillators stepped at 4 kHz, sampled by sensors of any rate."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings
from midspan.records import Channel, Measured, Samples, Source, joined, nanoseconds, seconds

FINE_HZ = 4000.0
# Natural frequency (Hz), damping ratio and standard deviation of displacement (m) of each mode.
BRIDGE = ((0.1, 0.3, 6e-3), (1.2, 0.02, 1e-3), (3.3, 0.01, 1.5e-3))
LIVELY = ((0.1, 0.3, 6e-3), (2.0, 0.02, 4e-3), (6.0, 0.02, 1e-3))
NOISE_A, NOISE_D, BIAS = 2e-3, 1e-4, 5e-3


@dataclass
class Truth:
    """Displacement and acceleration on a grid of 4 kHz; anything between is a straight line away (below 1e-8 m)."""

    x: np.ndarray
    a: np.ndarray

    def at(self, time_s, exposure_s=0.0):
        grid = np.arange(len(self.x)) / FINE_HZ
        if not exposure_s:
            return np.interp(time_s, grid, self.x)
        offsets = (np.arange(32) + 0.5) / 32 - 0.5
        return np.mean([np.interp(time_s + o * exposure_s, grid, self.x) for o in offsets], axis=0)

    def acceleration_at(self, time_s):
        return np.interp(time_s, np.arange(len(self.a)) / FINE_HZ, self.a)


def oscillating(rng, length_s, modes=BRIDGE):
    """A sum of oscillators under random forces below 12 Hz, each stepped exactly for a force held over a step."""
    n, lead = int(length_s * FINE_HZ) + 1, int(20 * FINE_HZ)
    x, a = np.zeros(n), np.zeros(n)
    for hz, damping, std in modes:
        force = sosfilt(butter(4, 12.0, fs=FINE_HZ, output="sos"), rng.normal(size=n + lead))
        w, h = 2 * np.pi * hz, 1.0 / FINE_HZ
        # Central differences: (x+ − 2 x + x−)/h² + 2 ζ w (x+ − x−)/2h + w² x = f; so is the acceleration.
        low, high = 1.0 - damping * w * h, 1.0 + damping * w * h
        moved = lfilter([0.0, h * h / high], [1.0, (w * w * h * h - 2.0) / high, low / high], force)
        scale = std / np.std(moved[lead:])
        moved *= scale
        x += moved[lead:]
        a += np.gradient(np.gradient(moved, h), h)[lead:]
    return Truth(x, a)


def samples_of(truth, rng, *, rate_hz=100.0, length_s=120.0, std=NOISE_A, bias=BIAS, start_s=0.5):
    time = start_s + np.arange(int(rate_hz * (length_s - start_s - 0.1))) / rate_hz
    value = truth.acceleration_at(time) + bias + rng.normal(0, std, len(time))
    density = np.full((len(time), 1), std**2 / rate_hz)
    return Samples(nanoseconds(time), value[:, None], density, np.zeros(len(time), dtype=np.uint8))


@dataclass
class Sensor:
    """One channel's measurements, to be spoilt: times (s), values and variances in its unit, reference variances."""

    channel: Channel
    time: np.ndarray
    value: np.ndarray
    variance: np.ndarray
    reference: np.ndarray


def sensor_of(truth, rng, channel=None, *, rate_hz=10.0, length_s=120.0, std=NOISE_D, start_s=0.504, zero=0.0):
    channel = channel or camera()
    time = start_s + np.arange(int(rate_hz * (length_s - start_s - 0.2))) / rate_hz
    exact = truth.at(time, channel.exposure_s) + zero
    value = channel.units_per_m * (exact + rng.normal(0, std, len(time)))
    variance = np.full(len(time), (channel.units_per_m * std) ** 2)
    return Sensor(channel, time, value, variance, np.zeros(len(time)))


def camera(**given):
    given = {"sensor": "camera", "source": Source.CAMERA, "units_per_m": 1.0, **given}
    given.setdefault("coasting_s", 0.4)
    return Channel(**given)


def measured_of(sensors):
    """All measurements in time order."""
    time_ns = np.concatenate([nanoseconds(s.time) for s in sensors])
    number = np.concatenate([np.full(len(s.time), i) for i, s in enumerate(sensors)])
    columns = [np.concatenate([getattr(s, name) for s in sensors]) for name in ("value", "variance", "reference")]
    order = np.lexsort((number, time_ns))
    return Measured(time_ns[order], number[order], *(column[order] for column in columns))


@dataclass
class Found:
    """What the estimator gave: rows of the first axis joined, all events, and the estimator itself."""

    rows: object
    events: list
    estimator: Estimator
    outputs: list

    def error_of(self, truth, datum_s=None):
        time = seconds(self.rows.time_ns, 0)
        exact = truth.at(time) - (truth.at(np.array([datum_s]))[0] if datum_s is not None else 0.0)
        return time, self.rows.displacement_m - exact


def estimated(samples, sensors, log=False, **given):
    settings = EstimatorSettings(channels=tuple(s.channel for s in sensors), **given)
    estimator = Estimator(settings, log=log)
    outputs = [*estimator.push(measured_of(sensors)), *estimator.push(samples), *estimator.finish()]
    rows = joined([one.estimates[0] for one in outputs if one.estimates])
    return Found(rows, [event for one in outputs for event in one.events], estimator, outputs)


def scores(found, truth, datum_s=None, inner=(5.0, 115.0)):
    """Rms error in mm, largest in mm, share inside 1.96 standard deviations."""
    time, error = found.error_of(truth, datum_s)
    within = (time > inner[0]) & (time < inner[1])
    error, std = error[within], np.sqrt(found.rows.variance_m2[within])
    return 1e3 * np.sqrt(np.mean(error**2)), 1e3 * np.abs(error).max(), np.mean(np.abs(error) < 1.96 * std)
