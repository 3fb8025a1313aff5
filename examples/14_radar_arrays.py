"""The radar chain on plain arrays: raw ADC data, range profiles, targets, and the displacement of the best one.

A wall 2.05 m away is seen at an angle (factor 1.27), next to a plate on the radar itself; 20 s of random motion.
"""

import tempfile
from pathlib import Path

import numpy as np

from midspan.radar.layout import Layout
from midspan.radar.measurement import TargetFrames, displacement
from midspan.radar.target import find_targets, ranked
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.radar.setup import Capture, demo_settings, write_capture
from midspan.simulate.radar.signal import SHORT_RANGE, RadarModel, Reflector
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest

motion = random_motion((0.5, 4.0), 2e-3, rng=np.random.default_rng(0))
model = RadarModel((Reflector(2.05, 900.0, ratio=1 / 1.27), Reflector(0.1, 2500.0, ratio=0.0)), noise_std=90.0)
time_s = np.arange(-1, 21, 0.01)
samples = np.column_stack((time_s, motion.acceleration(time_s)))  # s, m/s²

with tempfile.TemporaryDirectory() as folder:
    data, settings = Path(folder) / "adc_data.bin", Path(folder) / "radar.cfg"
    blocks = model.blocks(motion, 2000, rng=np.random.default_rng(1))
    write_capture(data, blocks, Capture(Layout(SHORT_RANGE, "QQII")))
    settings.write_text(demo_settings(SHORT_RANGE, frames=2000))

    source = open_radar(data, RadarRequest(config=settings))
    frame_s = source.times_ns() / 1e9
    profiles = np.concatenate([block.phasors for block in source.profiles()])
    target = ranked(find_targets(profiles, frame_s, samples=samples, axis=source.info.axis))[0]
    slow_time = list(source.slow_time(np.array([target.place_bin])))

frames = TargetFrames(
    frame_s,
    np.concatenate([block.phasors[..., 0] for block in slow_time]),
    np.concatenate([block.valid for block in slow_time]),
)
series = displacement(frames, target, samples=samples, phase_per_m=source.info.axis.phase_per_m(target.range_m))
error_m = series.value_m - motion.displacement(frame_s)
print(f"{len(frame_s)} frames, {profiles.shape[-1]} range bins")
print(f"range {target.range_m:.2f} m, conversion factor {target.conversion_factor:.4f} (true: 1.27)")
print(f"error {1e6 * np.nanstd(error_m):.1f} µm rms of {1e3 * np.ptp(motion.displacement(frame_s)):.1f} mm")
assert abs(target.conversion_factor - 1.27) < 0.005
assert np.nanstd(error_m) < 1e-5
