"""The zoom of images in which nothing moves is left alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from midspan.calibration.camera.zoom import without_zoom


@pytest.mark.parametrize("place_px", [0.0, 3.3])
def test_a_target_that_stays_exactly_in_its_place_has_no_zoom(place_px):
    # No line can be drawn through one place: numpy warned of its rank or gave up.
    frames = 200
    rows = SimpleNamespace(
        zoom=np.random.default_rng(1).normal(0.0, 1e-5, frames),
        variance_zoom=np.full(frames, 1e-10),
        along=lambda _axis: (np.full(frames, place_px), np.full(frames, 1e-4)),
    )
    target = SimpleNamespace(rows=rows)
    assert without_zoom([SimpleNamespace(axis="x")], target) is target
