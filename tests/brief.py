"""Scenarios made small, for what shows that everything is found and printed, and not how well."""

from dataclasses import replace

import pytest

from midspan.simulate.scenarios.table import SCENARIOS

# A picture that is rendered and tracked in a fraction of a second.
SMALL_PX = (96, 96)


def shorten(patch: pytest.MonkeyPatch, most_s: float) -> None:
    """No scenario lasts longer than this, s; a camera that looks at one structure alone has a small picture."""
    for name, one in SCENARIOS.items():
        camera = one.camera
        if camera is not None and camera.panels is None and not camera.targets:
            camera = replace(camera, size_px=SMALL_PX)
        patch.setitem(SCENARIOS, name, replace(one, duration_s=min(one.duration_s, most_s), camera=camera))
