"""A recording of a motion that is known at every instant."""

import json

import numpy as np

from midspan.recording.streams.recording import open_recording

NASTY = "bridge <script>alert(\"x\")</script> & 'co'"
FREQUENCIES, AMPLITUDES_M = (0.31, 1.37, 2.83), (2e-3, 1.5e-3, 0.6e-3)
SCALE_M_PER_PX = -1.5e-3


def displacement_m(t):
    # A smooth start: a kink would be an impulse of acceleration, which samples do not hold.
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.clip((t - 1.0) / 2.0, 0.0, 1.0))
    return ramp * sum(a * np.sin(2 * np.pi * f * t) for f, a in zip(FREQUENCIES, AMPLITUDES_M, strict=True))


def write_recording(folder, sections):
    """Accelerometer and truth of a known motion, and the settings' further sections."""
    fine = np.arange(0.0, 30.0, 1e-3)
    t = fine[::10]
    acceleration = np.gradient(np.gradient(displacement_m(fine), 1e-3), 1e-3)[::10]
    rng = np.random.default_rng(1)
    rows = np.column_stack((t, acceleration + 2e-3 * rng.standard_normal(len(t))))
    np.savetxt(folder / "accel.csv", rows, delimiter=",", header="time_s,accel", comments="")
    truth = np.column_stack((t, 1e3 * displacement_m(t)))
    np.savetxt(folder / "truth.csv", truth, delimiter=",", header="time_s,displacement_mm", comments="")
    text = (
        f"name = {json.dumps(NASTY)}\n"
        '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        '[reference]\nfile = "truth.csv"\ntime = "time_s"\nvalue = "displacement_mm"\nunit = "mm"\n'
    )
    (folder / "recording.toml").write_text(text + sections)
    return open_recording(folder)
