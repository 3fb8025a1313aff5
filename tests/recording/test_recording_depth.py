"""A camera that moves along its view before one target: its picture grows, by exact geometry of a pinhole."""

import numpy as np
import pytest

import midspan

FOCAL_PX, DISTANCE_M, SIZE_PX, RATE_HZ, DURATION_S = 5000.0, 10.0, 120, 10.0, 50.0


def up_m(t, order=0):
    """Modes that beat, and their derivatives."""
    tones = ((1.2, 1.03, 0.0), (0.9, 2.17, 1.0), (0.3, 3.41, 2.0))
    return sum(
        1e-3 * size * (2.0 * np.pi * hertz) ** order * np.sin(2.0 * np.pi * hertz * t + phase + 0.5 * np.pi * order)
        for size, hertz, phase in tones
    )


def along_m(t):
    """Slowly towards the target, and back."""
    return 8e-3 * np.sin(2.0 * np.pi * t / 27.0) + 4e-3 * np.sin(2.0 * np.pi * 0.31 * t)


def frames(met, along, seed=3):
    """Pictures (n, rows, columns) of a plane with waves on it, evaluated where each pixel's ray meets it."""
    rng = np.random.default_rng(seed)
    count = 24
    # 8 to 40 px at rest.
    wave = 2.0 * np.pi * FOCAL_PX / DISTANCE_M / rng.uniform(8.0, 40.0, count)
    angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, count))
    ray = (np.arange(SIZE_PX) - 0.5 * (SIZE_PX - 1)) / FOCAL_PX
    out = np.empty((len(met), SIZE_PX, SIZE_PX), dtype=np.uint8)
    for k, time_s in enumerate(met):
        apart = DISTANCE_M - along(time_s)
        # y down: the camera that goes up sees what is fixed lower.
        x, y = ray * apart, ray * apart - up_m(time_s)
        shade = np.cos(wave * np.cos(angle) * x[None, :, None] + wave * np.sin(angle) * y[:, None, None] + phase).sum(
            axis=-1
        )
        out[k] = np.clip(128.0 + 13.0 * shade + rng.normal(0.0, 1.0, shade.shape), 0.0, 255.0).round()
    return out


def recorded(folder, along, distance):
    met, at = np.arange(0.5, DURATION_S - 0.5, 1.0 / RATE_HZ), np.arange(0.0, DURATION_S, 0.01)
    np.savez(folder / "frames.npz", frames=frames(met, along))
    np.savetxt(folder / "times.csv", met, "%.6f", header="time_s", comments="")
    felt = up_m(at, 2) + 9.81 + np.random.default_rng(1).normal(0.0, 1e-3, len(at))
    np.savetxt(folder / "accel.csv", np.column_stack((at, felt)), "%.7f", ",", header="time_s,accel", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "frames.npz"\ntimes = "times.csv"\n'
        f'direction = "y"\n[[camera.target]]\nname = "post"\nroi = [14, 14, 92, 92]\n{distance}'
    )
    return folder, met


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
def test_motion_along_the_view_shows_in_the_size_of_a_target_at_a_known_distance(moves, tmp_path):
    along = along_m if moves else np.zeros_like
    folder, met = recorded(tmp_path, along, f"distance_m = {DISTANCE_M}\ndistance_std_m = 0.1\n")
    result = midspan.estimate(folder)
    assert set(result.pose.columns()) == {"translation_z_mm", "translation_z_std_mm"}
    columns = result.pose.columns()
    error = columns["translation_z_mm"] - 1e3 * (along(result.time_s) - along(met[0]))
    std = columns["translation_z_std_mm"]
    # A frame of a region of 92 px that is right to 0.002 px: √6 · 0.002 / 92 · 10 m = 0.5 mm.
    assert np.std(error) < 0.5
    assert np.mean(np.abs(error) < 1.96 * std) > 0.93
    assert np.median(std) < 0.6
    assert result.pose.metadata()["translation_zero_std_mm"][:2] == [None, None]
    assert any(line.code == "depth-by-size" for line in result.warnings)


def test_without_a_distance_there_is_none(tmp_path):
    folder, _ = recorded(tmp_path, np.zeros_like, "")
    assert midspan.estimate(folder).pose is None
