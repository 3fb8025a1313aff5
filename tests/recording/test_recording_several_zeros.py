"""Which instant the displacement of several sensors counts from, whichever of them begins first, a radar among them.

A radar's phases are used only after its first second; until then, and until its first measurement, the accelerometer
alone tells by how many cycles its phase moves from frame to frame: here by half of one and more.
"""

from dataclasses import replace

import numpy as np
import pytest

import midspan
from lively_recordings import CARRIER_HZ, CONVERSION, SPEED_OF_LIGHT_M_S, Lively, write_kinds
from repeats import slow

BASE = Lively(duration_s=15.0)
NORTH = replace(BASE, rate_hz=50.0, late_s=0.11)
SOUTH = replace(BASE, rate_hz=40.0, late_s=-0.07, first_s=1.3)
# A cycle of a radar's phase is so much displacement.
CYCLE_MM = 1e3 * CONVERSION * SPEED_OF_LIGHT_M_S / CARRIER_HZ / 2.0
# The phase noise of a frame, 0.02 rad, is so much displacement.
FRAME_NOISE_MM = 0.02 * CYCLE_MM / (2.0 * np.pi)
# Of each recording: its sensors, and the one whose first instant is the zero.
SITES = {
    "two radars": ({"north": ("radar", NORTH), "south": ("radar", SOUTH)}, "north"),
    "the first later": ({"north": ("radar", replace(NORTH, first_s=5.0)), "south": ("radar", SOUTH)}, "north"),
    "the second later": ({"north": ("radar", NORTH), "south": ("radar", replace(SOUTH, first_s=6.0))}, "north"),
    "radar and camera": ({"eye": ("camera", BASE), "south": ("radar", SOUTH)}, "eye"),
    "radar and GNSS": ({"north": ("radar", NORTH), "rover": ("displacement", replace(BASE, noise_m=4e-4))}, "north"),
}


@pytest.mark.parametrize(
    "site", ["the second later", "radar and camera", "radar and GNSS", *slow("two radars", "the first later")]
)
def test_several_sensors_count_from_the_first_ones_first_instant(site, tmp_path):
    named, first = SITES[site]
    result = midspan.estimate(write_kinds(tmp_path / "site", BASE, named))
    off = result.displacement_mm - named[first][1].from_zero_mm(result.time_s)
    # A lost cycle would be 2.4 mm; the zero of a camera's frame is known to 7 µm, of a radar by all frames to 5 µm.
    assert np.abs(off).max() < 0.1 * CYCLE_MM
    assert np.mean(np.abs(off) < 1.96 * result.displacement_std_mm) > 0.85
    # No sensor is said to have jumped, stepped or lost its cycle.
    assert not result.events
    measuring = {series.sensor for series in result.measured}
    assert measuring == set(named)


def test_the_zero_of_two_radars_is_what_all_frames_say_of_the_first_one(tmp_path):
    named, _ = SITES["two radars"]
    off, zero_mm = [], []
    for seed in range(3):
        sensors = {name: (kind, replace(case, seed=seed)) for name, (kind, case) in named.items()}
        result = midspan.estimate(write_kinds(tmp_path / f"{seed}", replace(BASE, seed=seed), sensors))
        off.append(result.displacement_mm - sensors["north"][1].from_zero_mm(result.time_s))
        zero_mm.append(1e3 * result.zero_std_m)
        # The first row is the first sample after the first frame.
        assert result.time_s[0] == pytest.approx(1.0, abs=0.02)
    # The phase of one frame would be a zero of FRAME_NOISE_MM; many make it two thirds of that or less.
    assert max(zero_mm) < 0.7 * FRAME_NOISE_MM
    # Three zeros: beyond 2.3 of their deviations (rms) once in a thousand.
    assert np.sqrt(np.mean([np.mean(one) ** 2 for one in off])) < 2.3 * max(zero_mm)
