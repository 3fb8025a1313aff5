"""Targets of a camera that differ by more than noise, at any frame rate: tilts are removed, movers left out or refused.

Tracks are written from physics: a target at the distance D moves by (displacement / D + tilt) times the focal length.
"""

from dataclasses import dataclass

import numpy as np
import pytest

import midspan
from lively_recordings import Lively
from recording_edits import append
from repeats import slow

FOCAL_PX, NOISE_PX = 5000.0, 0.01
RATES = (5.0, 10.0, 25.0)


def waves(band_hz, rms, seed):
    """A function of time: a sum of sines that is even over a band."""
    rng = np.random.default_rng(seed)
    hertz = np.linspace(*band_hz, 12) + rng.uniform(0.0, 0.5, 12) * (band_hz[1] - band_hz[0]) / 12.0
    phase = rng.uniform(0.0, 2.0 * np.pi, 12)
    return lambda t: rms * np.sqrt(2.0 / 12.0) * np.sin(np.multiply.outer(t, 2.0 * np.pi * hertz) + phase).sum(axis=-1)


def nothing(t):
    return np.zeros_like(t)


@dataclass(frozen=True)
class Site:
    """What a camera on a structure sees: distances (m); tilt (rad) and the last target's own motion (m), of time."""

    rate_hz: float
    distance_m: tuple[float, ...] = (3.0, 10.0)
    tilt: object = nothing
    own_m: object = nothing
    hidden_px: float = 0.0
    seed: int = 0

    @property
    def case(self):
        return Lively(seed=self.seed, rate_hz=self.rate_hz, duration_s=40.0, rms_m=2e-3, noise_m_s2=1e-3)

    def write(self, folder):
        case, rng = self.case, np.random.default_rng(self.seed)
        at, seen = np.arange(0.0, case.duration_s, 0.01), case.met_s
        accel = case.motion(at, 2) + case.bias_m_s2 + rng.normal(0.0, case.noise_m_s2, len(at))
        columns = {"time_s": seen}
        for k, distance_m in enumerate(self.distance_m):
            last = k == len(self.distance_m) - 1
            moved_m = case.motion(seen) + (self.own_m(seen) if last else 0.0)
            y_px = -FOCAL_PX * (moved_m / distance_m + self.tilt(seen)) + rng.normal(0.0, NOISE_PX, len(seen))
            if last:
                y_px += self.hidden_px * ((seen > 20.0) & (seen < 20.5))
            end = "" if k == 0 else f"_target{k + 1}"
            columns |= {f"x_px{end}": rng.normal(0.0, NOISE_PX, len(seen)), f"y_px{end}": y_px}
        write_table(folder / "accel.csv", {"time_s": at, "accel": accel})
        write_table(folder / "track.csv", columns)
        (folder / "recording.toml").write_text(
            '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "track.csv"\ndirection = "y"\n'
        )
        return folder

    def error_mm(self, result):
        return result.displacement_mm - self.case.from_zero_mm(result.time_s)


def write_table(file, columns):
    np.savetxt(file, np.column_stack(list(columns.values())), "%.7f", ",", header=",".join(columns), comments="")


def slow_tilt(mdeg, seed=3):
    return waves((0.02, 0.15), np.radians(1e-3 * mdeg), seed)


@pytest.mark.parametrize("rate_hz", [RATES[0], *slow(*RATES[1:])])
def test_a_tilt_of_much_of_the_motion_is_removed_at_every_rate(rate_hz, tmp_path):
    # 6 mdeg move the near target by 0.31 mm and the far one by 1.05 mm.
    site = Site(rate_hz, tilt=slow_tilt(6.0))
    result = midspan.estimate(site.write(tmp_path))
    error = site.error_mm(result)
    # A frame of the difference is good for 0.012 mm, and the zero rests on the first frames.
    assert np.std(error) < 0.012
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    assert [line.code for line in result.warnings if "targets 1 and target2" in line] == ["tilt"]


@pytest.mark.parametrize("rate_hz", [RATES[1], *slow(RATES[0], *RATES[2:])])
def test_a_small_tilt_is_in_the_band_at_every_rate(rate_hz, tmp_path):
    # 0.6 mdeg: 0.03 mm at the near target, seven times the band of targets that agree, 1.6 % of the motion.
    site = Site(rate_hz, tilt=slow_tilt(0.6))
    result = midspan.estimate(site.write(tmp_path))
    inside = np.abs(site.error_mm(result)) < 1.96 * result.displacement_std_mm
    # A tilt is slow: a record holds few independent errors.
    assert np.mean(inside) > 0.9
    assert any(line.code == "motion-not-shared" and "target2" in line for line in result.warnings)


@pytest.mark.parametrize(
    ("rate_hz", "distance_m"), [(5.0, (10.0, 3.0)), (10.0, (3.0, 10.0)), *slow((25.0, (3.0, 10.0)))]
)
def test_a_target_that_sways_is_left_out_where_the_accelerometer_tells_it(rate_hz, distance_m, tmp_path):
    # 0.6 mm at 0.5 to 0.9 Hz would be 20 mm/s² of tilt in the other target, where the accelerometer has 1.
    site = Site(rate_hz, distance_m, own_m=waves((0.5, 0.9), 0.6e-3, 4))
    result = midspan.estimate(site.write(tmp_path))
    assert [target.name for target in result.calibration.camera.targets if target.used] == ["1"]
    error = site.error_mm(result)
    # One target alone: a frame is good for 0.006 or 0.02 mm, and no tilt is left to be held.
    assert np.sqrt(np.mean(error**2)) < np.median(result.displacement_std_mm) * 1.5 < 0.05
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


def test_a_tilt_that_shakes_all_targets_at_one_distance_alike_is_taken_out(tmp_path):
    # 2 mdeg at 3.2 to 3.8 Hz, which frames at 5 Hz show as 1.2 to 1.8 Hz: 0.35 mm of both at 10 m.
    site = Site(5.0, (10.0, 10.0), tilt=waves((3.2, 3.8), np.radians(2e-3), 5))
    result = midspan.estimate(site.write(tmp_path))
    error = site.error_mm(result)
    # All rows have the error of the first frame's zero in common: one error alone is inside with 95 %.
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    assert [line.code for line in result.warnings if "vibrates by" in line] == ["motion-not-shared"]


@pytest.mark.parametrize(
    ("rate_hz", "distance_m"), [(5.0, (3.0, 5.0, 10.0)), *slow((5.0, (3.0, 10.0)), (25.0, (10.0, 10.0)))]
)
def test_targets_that_agree_widen_nothing(rate_hz, distance_m, tmp_path):
    found = midspan.calibrate(Site(rate_hz, distance_m, seed=1).write(tmp_path))
    assert all(target.used for target in found.camera.targets)
    # Of a thousand records with white noise one has a difference that counts.
    assert found.camera.apart_std_m == 0.0


def test_what_hides_a_target_for_a_while_is_no_motion_of_its_own(tmp_path):
    site = Site(10.0, hidden_px=1.0)
    result = midspan.estimate(site.write(tmp_path))
    assert [target.name for target in result.calibration.camera.targets if target.used] == ["1", "target2"]
    assert result.calibration.camera.apart_std_m == 0.0
    # 1 px of the far target is 2 mm.
    assert np.max(np.abs(site.error_mm(result))) < 0.1


def test_a_tilt_is_removed_with_a_majority_at_one_distance(tmp_path):
    # Both far targets move alike with the tilt, and the near one alone is nearly right.
    site = Site(10.0, (10.0, 10.0, 3.0), tilt=slow_tilt(6.0))
    result = midspan.estimate(site.write(tmp_path))
    error = site.error_mm(result)
    assert np.std(error) < 0.012
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85


@pytest.mark.parametrize("far_m", ["10.0", '"far"'])
def test_distances_that_are_declared_decide_on_a_tilt_that_the_accelerometer_does_not(far_m, tmp_path):
    # 0.6 mdeg: as in the band above, where no distance is declared.
    distances = (3.0, 10.0 if far_m == "10.0" else 1e9)
    site = Site(10.0, distances, tilt=slow_tilt(0.6))
    targets = "".join(
        f'[[camera.target]]\nname = "{name}"\nroi = [{x}, 0, 9, 9]\ndistance_m = {distance}\n'
        for name, x, distance in (("1", 0, "3.0"), ("target2", 20, far_m))
    )
    append(site.write(tmp_path), targets)
    result = midspan.estimate(tmp_path)
    error = site.error_mm(result)
    # A frame of the difference is good for 0.012 mm; the tilt moves the near target by 0.03 mm.
    assert np.std(error) < 0.012
    assert np.mean(np.abs(error) < 1.96 * result.displacement_std_mm) > 0.85
    assert np.median(result.displacement_std_mm) < 0.02


def test_targets_at_several_distances_that_agree_exclude_a_tilt(tmp_path):
    site = Site(10.0, (3.0, 5.0, 10.0), own_m=waves((0.03, 0.2), 0.6e-3, 6))
    found = midspan.calibrate(site.write(tmp_path)).camera
    assert [target.name for target in found.targets if target.used] == ["1", "target2"]
    assert found.apart_std_m == 0.0
