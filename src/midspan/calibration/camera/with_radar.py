"""A camera that tilts, with a radar as its partner.

A radar tells the displacement along its line of sight, which a tilt about its own place does not move. What a camera's
only target shows besides that displacement, beyond the noise of a frame, is its tilt (or a motion of its target): a
state of the estimator, of the size that shows here, so that the displacement rests on the radar.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from midspan.calibration.camera.calibrate import CameraFit
from midspan.calibration.camera.difference import difference
from midspan.calibration.camera.disagreement import MIN_APART_M
from midspan.calibration.camera.tilt import walk_of
from midspan.calibration.camera.view import SeenTarget, View, filter_settings, target_block
from midspan.calibration.sensors.camera import SLOW_TILT
from midspan.calibration.sensors.fit import SensorFit
from midspan.fusion.path import at
from midspan.fusion.streams import smooth
from midspan.notices import Notice, rounded
from midspan.records import NANOSECONDS, part
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.signals.stamps import inside


def with_tilt(
    view: View, target: SeenTarget, fit: CameraFit, radar: SensorFit[Any, Any]
) -> tuple[CameraFit, Notice | None]:
    """The camera's calibration with the size of the tilt that the radar does not show, and a sentence on it.

    As it is, and None, where the camera shows no more than the radar.
    """
    camera, moved = fit.calibration, radar.moved
    assert moved is not None
    (mapping,) = camera.mappings()
    acceleration = view.prepared.with_noise(radar.input_noise.density, radar.input_noise.motion_s)
    block = target_block(target, mapping, camera.exposure_s, acceleration)
    seen = part(block, inside(block.time_ns, int(moved.time_ns[0]), int(moved.time_ns[-1])))
    first, last = int(moved.time_ns[0]) - NANOSECONDS, int(moved.time_ns[-1]) + NANOSECONDS
    near = part(acceleration, slice(*(int(k) for k in np.searchsorted(acceleration.time_ns, (first, last)))))
    path = smooth(
        near, moved, filter_settings(view.prepared, radar.input_noise.density, lean=GRAVITY_M_S2 * radar.slope)
    ).estimate
    expected = at(path, seen.time_ns)[0]
    scale_std = float(np.hypot(camera.relative_std, radar.calibration.relative_std))
    found = difference(seen.value_m - expected, seen.variance_m2, expected, scale_std)
    if not found.excess_m > max(found.noise_m, MIN_APART_M):
        return fit, None
    per_px = abs(mapping.scale_m_per_px)
    step_s = float(np.median(np.diff(seen.time_ns))) / NANOSECONDS
    apart_m = max(camera.apart_std_m**2 - (SLOW_TILT * camera.slow_std_m) ** 2, 0.0) ** 0.5
    camera = replace(
        camera,
        tilt_std_px=found.excess_m / per_px,
        tilt_walk_px2_s=walk_of((seen.value_m - expected) / per_px, step_s),
        apart_std_m=apart_m if camera.slow_std_m > 0.0 else camera.apart_std_m,
        slow_std_m=0.0,
        slow_time_s=np.inf,
        slow_hz=0.0,
    )
    size = f"{rounded(found.excess_m / per_px)} px rms in the image, {rounded(1e3 * found.excess_m)} mm of displacement"
    text = (
        f"camera: it tilts by {size}, which the radar does not show; or its target moves by that. The displacement "
        "rests on the radar."
    )
    return replace(fit, calibration=camera), Notice("tilt", text)
