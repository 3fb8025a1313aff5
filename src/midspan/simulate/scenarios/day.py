"""The recordings of `midspan simulate` that last from noon to noon."""

import numpy as np

from midspan.simulate.day.infrared import DayCourse
from midspan.simulate.day.setup import DaySetup, Eye, hours, span_hours
from midspan.simulate.day.sky import Sky
from midspan.simulate.day.weather import Headlights
from midspan.simulate.motion.motion import Motion, Sum, Window, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel
from midspan.simulate.scenarios.stage import Scenario
from midspan.simulate.scene.thermal import ThermalCamera, WarmBody

DAY_S = 264.0  # 24 hours last so long: 11 s an hour
# Autumn: the sun stays before the wall until it sets, and moves as fast as in the light sweeps of the benchmarks.


def _footbridge(rng: np.random.Generator) -> Motion:
    """Modes at 0.9 and 2.3 Hz that come and go, and a slow sag below 0.05 Hz; at rest for 1.5 s."""
    parts = (
        random_motion((0.80, 1.00), 1.6e-3, rng=rng, lines=60),
        random_motion((2.20, 2.40), 0.3e-3, rng=rng, lines=60),
        random_motion((0.006, 0.05), 2.0e-3, rng=rng, lines=16),
    )
    return Window(Sum(parts), start_s=1.5, ramp_s=2.0)


_SKY = Sky(
    length_s=DAY_S,
    declination_deg=-8.0,
    fog=(span_hours(DAY_S, 18.2, 19.9),),
    rain=(span_hours(DAY_S, 3.6, 4.4),),
    ramp_s=5.0,
)
_THERMAL = ThermalCamera(
    netd_k=0.05,
    pattern_k=0.04,
    column_k=0.02,
    drift_k_per_s=0.004,
    shutters_s=hours(DAY_S, 2.3, 7.2, 12.1, 16.6, 21.0),
    closed_s=0.7,
)
_BODIES = tuple(WarmBody(start_s=s, top_px=25.0, height_px=90.0, width_px=36.0) for s in hours(DAY_S, 9.0, 14.0))

DAY_SCENARIOS: dict[str, Scenario] = {
    "day-and-night": Scenario(
        line="noon to noon in 4.4 minutes, camera and infrared at 4 Hz: shadows, darkness, headlights, rain, fog, heat",
        title="simulated footbridge by day and by night",
        duration_s=DAY_S,
        motion=_footbridge,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=2.5e-3, bias_m_s2=0.05),
        window_s=(0.0, 38.0),
        day=DaySetup(
            sky=_SKY,
            camera=Eye((168, 224), scale_mm_per_px=-1.0, time_offset_s=0.137),
            infrared=Eye((120, 160), scale_mm_per_px=-1.1, start_s=0.06, time_offset_s=-0.083),
            course=DayCourse(mean_c=14.0, swing_k=6.0, period_s=DAY_S),
            thermal=_THERMAL,
            bodies=_BODIES,
            # Beside the post's shadow at noon, whose edges would be the best texture of the picture.
            camera_roi=(22, 64, 64, 64),
            cars=Headlights(hours(DAY_S, 7.6, 9.8, 12.6, 15.0), row_px=140.0),
        ),
    ),
}
