"""The range of temperatures that 8 bits should show."""

import numpy as np
import pytest
from thermal_cases import REGION, filmed, followed, swing, wall

from midspan.errors import UntrustedError, UsageError
from midspan.records import Frame, PixelTrack, Status
from midspan.simulate.scene.thermal import ThermalView, WarmBody
from midspan.thermal.limits import Limits
from midspan.thermal.temperature_range import (
    Expected,
    band_error,
    candidates,
    field_range,
    grey,
    optimise_range,
    region_range,
)

CUP = WarmBody(left_px=96.0, top_px=40.0, width_px=14.0, height_px=30.0, speed_px_s=0.0, celsius=60.0)
ICE = WarmBody(left_px=1.0, top_px=40.0, width_px=14.0, height_px=30.0, speed_px_s=0.0, celsius=-10.0)


@pytest.fixture(scope="module")
def cups():
    """A wall between a hot and a cold cup, as in the published test."""
    moved = swing(48)
    return filmed(ThermalView((wall(),), contrast_k=0.7, bodies=(CUP, ICE)), moved), moved


def by_sift(frames):
    return followed(frames, "features", detector="sift", max_features=150)


def test_limits_go_in_equal_steps_from_the_regions_to_the_field_of_views() -> None:
    # The published example: 16.79 °C is the region's lower limit less eight of nine steps of 0.857 K, and so on.
    low, high = candidates(Limits(23.65, 28.08), Limits(15.94, 33.52))
    assert low[8] == pytest.approx(16.79, abs=0.01)
    assert (low[0], high[0], low[-1], high[-1]) == pytest.approx((23.65, 28.08, 15.94, 33.52))
    assert np.diff(low) == pytest.approx(np.full(9, -0.857), abs=0.001)
    assert np.diff(high) == pytest.approx(np.full(9, 0.604), abs=0.001)
    with pytest.raises(UsageError):
        candidates(Limits(10.0, 20.0), Limits(12.0, 30.0))


def test_grey_levels_cover_the_range_and_clip_what_lies_outside() -> None:
    limits = Limits(10.0, 35.5)
    assert grey(np.array([[9.0, 10.0, 22.75, 35.5, 70.0]]), limits).tolist() == [[0, 0, 128, 255, 255]]


def test_only_what_lies_in_the_band_counts_as_error() -> None:
    time = (np.arange(400) + np.random.default_rng(0).uniform(-0.2, 0.2, 400)) / 20.0
    drift, inside, above = 3.0 * time / 20, 0.5 * np.sin(2 * np.pi * 1.05 * time), np.sin(2 * np.pi * 6.0 * time)
    # The rms of a sine is its amplitude over √2; the ramp leaks at its ends, the jitter a little.
    assert band_error(time, drift + inside + above, (0.3, 3.0)) == pytest.approx(0.5 / np.sqrt(2), rel=0.12)
    assert band_error(time, drift, (0.3, 3.0)) < 0.02
    lost = np.where(np.arange(400) % 7 == 0, np.nan, inside)
    assert band_error(time, lost, (0.3, 3.0)) == pytest.approx(0.5 / np.sqrt(2), rel=0.05)


def test_the_range_of_the_field_of_view_makes_the_target_too_pale_and_the_chosen_one_does_not(cups) -> None:
    frames, moved = cups
    surface = optimise_range(frames, REGION, by_sift, Expected(moved[:, 1], "y", (0.3, 3.0)), 3)
    assert surface.error_px.shape == surface.lost.shape == (4, 4)
    assert np.isnan(surface.error_px[3, 3])  # the published finding: matches fail with the range of the whole view
    assert surface.lost[3, 3] > 0.2
    assert surface.lost[0, 0] == 0.0
    best = np.unravel_index(np.nanargmin(surface.error_px), (4, 4))
    assert (surface.best.low_c, surface.best.high_c) == (surface.low_c[best[0]], surface.high_c[best[1]])
    # 0.05 K of noise on 0.7 K of contrast; the goal is 0.06 px.
    assert np.nanmin(surface.error_px) < 0.06
    assert surface.low_c[0] == region_range(frames, REGION).low_c
    assert surface.high_c[-1] == field_range(frames).high_c


def test_without_any_range_that_keeps_the_target_the_result_is_refused(cups) -> None:
    frames, moved = cups

    def blind(shown):
        track = followed(shown[:1])
        nan = np.full(len(shown), np.nan)
        times = np.array([f.time_ns for f in shown])
        lost = np.full(len(shown), Status.LOST, dtype=np.uint8)
        assert track.x_px.size == 1
        return PixelTrack(times, nan, nan, nan, nan, nan, lost, nan, nan)

    with pytest.raises(UntrustedError, match="No temperature range"):
        optimise_range(frames, REGION, blind, Expected(moved[:, 1], "y", (0.3, 3.0)), 1)
    with pytest.raises(UsageError):
        optimise_range(frames[:4], REGION, blind, Expected(moved[:4, 1], "y", (0.3, 3.0)), 1)
    with pytest.raises(UsageError, match="one or more"):
        field_range([])


def test_ranges_that_are_the_same_are_tracked_once() -> None:
    moved = swing(20)
    frames = filmed(ThermalView((wall(),), contrast_k=0.7), moved)
    inside = [Frame(f.time_ns, f.pixels[14:74, 20:92], f.index) for f in frames]
    calls = []

    def counting(shown):
        calls.append(len(shown))
        return PixelTrack.stack([])

    whole = type(REGION)(0, 0, 72, 60)
    with pytest.raises(UntrustedError):
        optimise_range(inside, whole, lambda s: _lost(counting(s), s), Expected(moved[:, 1], "y", (0.3, 3.0)), 4)
    assert len(calls) == 1


def _lost(_, frames):
    nan = np.full(len(frames), np.nan)
    times = np.array([f.time_ns for f in frames])
    return PixelTrack(times, nan, nan, nan, nan, nan, np.full(len(frames), 2, dtype=np.uint8), nan, nan)
