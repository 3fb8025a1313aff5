"""Faults of a live site, one after another: each is said, nobody else is blamed, it is over soon, the rows hold."""

import numpy as np
import pytest
from benchmarks.live.faults import FAULTS, SOUND, WRONG, Rig, tried
from benchmarks.live.sensors import FAST_S, NOISE_M, NOISE_M_S2, PERIOD_S, SLOW_S, Transmitter, motion
from benchmarks.live.site import RunningSite

import midspan
from repeats import slow


def calibrated(folder, moved, seed):
    """A calibration of a point's sensors, made before the site runs."""
    folder.mkdir()
    rng = np.random.default_rng(seed)
    fast, slow = np.arange(0.0, 30.0, FAST_S), np.arange(0.0, 30.0, SLOW_S)
    acceleration = moved.acceleration(fast % PERIOD_S) + rng.normal(0.0, NOISE_M_S2, len(fast))
    value = 1e3 * (moved.displacement(slow % PERIOD_S) + rng.normal(0.0, NOISE_M, len(slow)))
    np.savez(folder / "a.npz", time_s=fast, accel=acceleration)
    np.savez(folder / "d.npz", time_s=slow, d=value)
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.npz"\nunit = "m/s^2"\n[displacement]\nfile = "d.npz"\nunit = "mm"\n'
    )
    midspan.calibrate(folder).save(folder / "calibration.json")
    return folder / "calibration.json"


@pytest.fixture
def rig(mosquitto, tmp_path):
    """A site of two points that run."""
    motions = {WRONG: motion(1), SOUND: motion(2)}
    files = {name: calibrated(tmp_path / name, one, 5) for name, one in motions.items()}
    sensors = Transmitter(mosquitto.port, motions)
    sensors.start()
    site = RunningSite(tmp_path, mosquitto.port, motions, {}, calibrations=files)
    site.start()
    site.until(lambda reasons: not reasons and running(site), 300.0)
    yield Rig(site, mosquitto, None, sensors, None)
    sensors.stop()
    assert site.stop() == 0


def running(site):
    try:
        return all(np.isfinite(site.rows_s(name)) for name in site.motions)
    except midspan.MidspanError:
        return False


@pytest.mark.parametrize(
    ("names", "kinds"),
    [
        (["accelerometer NaN"], {"no_values"}),
        *slow((["broker gone 10 s", "accelerometer silent"], {"broker_gone", "returned"})),
    ],
)
def test_faults_are_said_nobody_else_is_blamed_and_all_is_well_again(names, kinds, rig):
    for name in names:
        # How fast it is said and over depends on the machine: `make faults` measures that.
        noticed_s, others, back_s, held = tried(rig, FAULTS[name], after_s=5.0)
        assert np.isfinite(noticed_s), name
        assert np.isfinite(back_s), name
        assert others == set(), name
        for point, one in held.items():
            assert one.rows > 500, (name, point)
            assert one.inside > 0.8, (name, point)
            assert one.worst < 8.0, (name, point)
    assert kinds <= {event.kind for event in rig.site.events(WRONG)}
    assert "no_values" not in {event.kind for event in rig.site.events(SOUND)}
