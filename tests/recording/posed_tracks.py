"""Recordings of a camera in six degrees of freedom as tables of tracks, by a pinhole written with plain matrices."""

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

FOCAL_PX, NOISE_PX, RATE_HZ, FRAME_HZ, LATE_S = 5000.0, 0.003, 100.0, 20.0, 0.114
SIZE = (1700, 900)
# Left and right at 3 m, below between them at 10 m: middles of the regions, px.
THREE = {"1": (40, 100, 3.0), "2": (1660, 100, 3.0), "far": (950, 800, 10.0)}


def waves(rng, *bands):
    """A motion as sines in bands (low, high, rms): a function of time that gives it and its second derivative."""
    parts = []
    for low, high, rms in bands:
        frequency = rng.uniform(low, high, 12)
        parts.append((2.0 * np.pi * frequency, rng.uniform(0.0, 2.0 * np.pi, 12), rms * np.sqrt(2.0 / 12.0)))

    def at(time_s):
        value, bent = np.zeros(len(time_s)), np.zeros(len(time_s))
        for omega, phase, amplitude in parts:
            wave = amplitude * np.sin(np.multiply.outer(time_s, omega) + phase)
            value += wave.sum(axis=1)
            bent -= (wave * omega**2).sum(axis=1)
        return value, bent

    return at


def motions(rng, turns=1.0):
    """Of the six degrees, in m and rad: modes and slow parts; turns: factor on the rotations."""
    mdeg = turns * np.radians(1e-3)
    return [
        waves(rng, (1.0, 1.2, 0.8e-3), (0.01, 0.03, 1e-3)),
        waves(rng, (2.0, 2.2, 1.0e-3), (0.01, 0.03, 1.5e-3)),
        waves(rng, (0.7, 0.9, 0.3e-3), (0.01, 0.03, 1.5e-3)),
        waves(rng, (2.0, 2.2, 3.0 * mdeg), (0.01, 0.03, 6.0 * mdeg)),
        waves(rng, (1.5, 1.7, 2.0 * mdeg), (0.01, 0.03, 8.0 * mdeg)),
        waves(rng, (1.0, 1.2, 5.0 * mdeg), (0.01, 0.03, 10.0 * mdeg)),
    ]


def seen_px(place_px, distance_m, pose, focal_px=FOCAL_PX):
    """Where a camera at each pose (n, 6) sees points, less where it sees them at rest."""
    points = np.column_stack((place_px / focal_px * distance_m[:, None], distance_m))
    found = []
    for row in pose:
        own = Rotation.from_rotvec(row[3:]).inv().apply(points - row[:3])
        found.append(focal_px * own[:, :2] / own[:, 2:] - place_px)
    return np.array(found)


def written(
    folder,
    seed=1,
    targets=THREE,
    duration_s=30.0,
    declared=True,
    off_m=None,
    lost=(),
    lever_m=(0, 0, 0),
    turns=1.0,
    drift_px=0.0,
):
    """A recording's folder, and the true poses (n, 6) at the accelerometer's times (n,).

    declared: whether the settings have the distances; off_m: by target, what its true distance is more than declared;
    lost: (target, first and last frame) that are not seen; lever_m: from the accelerometer to the camera; turns: see
    `motions`; drift_px: by which the last target moves on its own.
    """
    rng = np.random.default_rng(seed)
    degrees, time_s = motions(rng, turns), np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    frames_s = np.arange(0.05, duration_s - 0.2, 1.0 / FRAME_HZ) + LATE_S
    pose = np.column_stack([one(frames_s)[0] for one in degrees])
    names, places = list(targets), np.array([one[:2] for one in targets.values()], dtype=float)
    declared_m = np.array([one[2] for one in targets.values()])
    distance_m = declared_m + np.array([(off_m or {}).get(name, 0.0) for name in names])
    distance_std_m = 0.002 * declared_m
    if off_m is None:
        distance_m = rng.normal(declared_m, distance_std_m)
    axis_px = np.array([0.5 * (SIZE[0] - 1), 0.5 * (SIZE[1] - 1)])
    still, turned = pose[0, :3], Rotation.from_rotvec(pose[:, 3:])
    own = np.hstack((turned[0].inv().apply(pose[:, :3] - still), (turned[0].inv() * turned).as_rotvec()))
    moved = seen_px(places - axis_px, distance_m, own)
    moved[1:] += rng.normal(0.0, NOISE_PX, (len(pose) - 1, len(names), 2)) - rng.normal(0.0, NOISE_PX, (len(names), 2))
    # The last target settles in the course of the record.
    moved[:, -1, 1] += drift_px * np.linspace(0.0, 1.0, len(pose)) ** 2
    for name, first, last in lost:
        moved[first:last, names.index(name)] = np.nan
    folder.mkdir(parents=True, exist_ok=True)
    columns = {"time_s": frames_s - LATE_S}
    for k, end in enumerate("" if name == "1" else f"_{name}" for name in names):
        columns |= {f"x_px{end}": moved[:, k, 0], f"y_px{end}": moved[:, k, 1]}
        columns |= dict.fromkeys((f"std_x_px{end}", f"std_y_px{end}"), np.full(len(frames_s), NOISE_PX))
    write_csv(folder / "track.csv", columns)
    regions = [[int(x) - 40, int(y) - 40, 81, 81] for x, y, _ in targets.values()]
    (folder / "track.json").write_text(
        str({"targets": [{"name": n, "roi": r} for n, r in zip(names, regions, strict=True)]}).replace("'", '"')
    )
    # Upwards, at the accelerometer; it turns with the camera.
    turn = [one(time_s)[1] for one in degrees[3:]]
    at_box = degrees[1](time_s)[1] - (turn[2] * lever_m[0] - turn[0] * lever_m[2])
    write_csv(folder / "accel.csv", {"time_s": time_s, "a": 9.81 - at_box + rng.normal(0.0, 1e-3, len(time_s))})
    camera = {
        "file": "track.csv",
        "lens": {"matrix": [FOCAL_PX, FOCAL_PX, *axis_px.tolist()], "distortion": [0.0] * 4, "size": list(SIZE)},
        "target": [{"name": n, "roi": r} for n, r in zip(names, regions, strict=True)],
    }
    for one, distance, std in zip(camera["target"], declared_m, distance_std_m, strict=True):
        if declared is True or one["name"] in (declared or ()):
            one |= {"distance_m": float(distance), "distance_std_m": float(std)}
    accelerometer = {"file": "accel.csv", "time": "time_s", "value": "a", "unit": "m/s^2"}
    if any(lever_m):
        accelerometer["camera_offset_m"] = list(lever_m)
    (folder / "recording.toml").write_text(tomli_w.dumps({"accelerometer": accelerometer, "camera": camera}))
    pose = np.column_stack([one(time_s)[0] for one in degrees])
    turned_0 = turned[0].inv()
    true = np.hstack((turned_0.apply(pose[:, :3] - still), (turned_0 * Rotation.from_rotvec(pose[:, 3:])).as_rotvec()))
    return folder, time_s, true


def write_csv(path, columns):
    """A table, empty where there is no number."""
    rows = zip(*columns.values(), strict=True)
    lines = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")
