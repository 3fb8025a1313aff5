"""The FIR methods together with several sensors: these take turns, for the filters are made for one series."""

import numpy as np
import pytest

from midspan.fusion.runners import run_method
from midspan.fusion.streams import KalmanSettings, MethodSettings
from midspan.papers.printed.in_turn import in_turn
from midspan.records import Acceleration, Displacement, Source, joined, nanoseconds, part

PARTS = ((1.5e-3, 0.43), (0.75e-3, 1.13), (0.3e-3, 2.31))
TIME = np.arange(4000) / 100.0
NOISE_M = 5e-6


def motion(time, order=0):
    """Displacement (order 0, m) or acceleration (order 2, m/s²) at the times, s."""
    return sum((-1 if order else 1) * a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * time) for a, f in PARTS)


def measured(source, rate_hz, seed, begin_s=0.13, dark=(0.0, 0.0)):
    time = np.arange(begin_s, 39.7, 1.0 / rate_hz)
    value = motion(time) + NOISE_M * np.random.default_rng(seed).standard_normal(len(time))
    value[(time > dark[0]) & (time < dark[1])] = np.nan
    return Displacement(
        nanoseconds(time), value, np.full(len(time), NOISE_M**2), np.full(len(time), source, dtype=np.uint8)
    )


def together(*blocks):
    both = joined(list(blocks))
    return part(both, np.argsort(both.time_ns, kind="stable"))


def judged(given, method):
    """Error's rms in mm, share inside 1.96 σ, and the events."""
    rng = np.random.default_rng(1)
    value = motion(TIME, 2) + 0.03 + 4e-3 * rng.standard_normal(len(TIME))
    acceleration = Acceleration(nanoseconds(TIME), value, np.full(len(TIME), 4e-3**2 * 0.01))
    settings = MethodSettings(kalman=KalmanSettings(bias=0.03, coasting_s=0.7))
    found = run_method(method, acceleration, in_turn(given), settings)
    error = found.estimate.displacement_m - motion(found.estimate.time_ns / 1e9)
    inside = np.abs(error) < 1.96 * np.sqrt(found.estimate.variance_m2)
    return 1e3 * float(np.sqrt(np.mean(error**2))), float(np.mean(inside)), found.events


@pytest.mark.parametrize("method", ["fir", "two-stage-fir"])
def test_a_second_camera_at_other_instants_spoils_neither_the_rows_nor_their_band(method):
    camera, infrared = measured(Source.CAMERA, 5.0, 2), measured(Source.INFRARED, 4.0, 3, 0.21)
    alone, _, _ = judged(together(camera), method)
    both, inside, events = judged(together(camera, infrared), method)
    # Together as one uneven series they gave `fir` three times the error, with 40 % of it inside the band.
    assert both < 1.1 * alone
    assert inside > 0.88
    assert events == ()


@pytest.mark.parametrize("method", ["fir", "two-stage-fir"])
def test_a_camera_that_goes_dark_is_replaced_by_the_other_without_a_gap(method):
    dark = measured(Source.CAMERA, 5.0, 2, dark=(12.0, 27.0))
    rms, inside, events = judged(together(dark, measured(Source.INFRARED, 4.0, 3, 0.21)), method)
    # What 4 frames a second alias of 2.31 Hz stays in the result of `fir`, and is in its band.
    assert rms < 0.06
    assert inside > 0.88
    assert [event.kind for event in events] == []


def test_a_slow_sensor_that_stands_in_is_reported_once_and_its_rows_are_the_smoothers():
    dark = measured(Source.CAMERA, 10.0, 2, dark=(12.0, 27.0))
    rms, inside, events = judged(together(dark, measured(Source.INFRARED, 2.0, 3, 0.21)), "fir")
    (event,) = events
    assert event.kind == "rate"
    assert event.time_ns / 1e9 == pytest.approx(12.0, abs=0.6)
    assert "came every 0.49 s only, and not every 0.1 s" in event.text
    assert rms < 0.03
    assert inside > 0.88


def test_each_instant_has_one_sensor_the_one_that_tells_most_where_it_sees():
    camera, infrared = measured(Source.CAMERA, 5.0, 2, dark=(12.0, 27.0)), measured(Source.INFRARED, 4.0, 3, 0.21)
    kept = in_turn(together(camera, infrared))
    time = kept.time_ns / 1e9
    # Five frames a second tell more than four of the same noise; the dark one's place is taken at once, without a hole.
    expected = (time > 12.0) & (time < 27.0)
    edge = np.min(np.abs(time[:, None] - np.array([0.0, 12.0, 27.0, 39.7])), axis=1) < 0.5
    assert np.array_equal((kept.source == Source.INFRARED)[~edge], expected[~edge])
    assert np.isfinite(kept.value_m).all()
    assert np.diff(time).max() < 0.5
    assert in_turn(camera) is camera
