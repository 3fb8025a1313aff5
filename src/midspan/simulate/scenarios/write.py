"""How the recording of a scenario is written: each sensor's file, the truth, and what an estimate should find."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from midspan.checks import option
from midspan.records import Region
from midspan.simulate.files.folder import (
    MARK,
    Progress,
    check_free,
    exact_in_video,
    whole_folder,
    write_table,
    write_video,
)
from midspan.simulate.scenarios.breaks import broken
from midspan.simulate.scenarios.stage import CameraSetup, Scenario, Stage, stage, within
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scene.camera import View, cramer_rao_std_px
from midspan.simulate.scene.pose import PosedView


def write(
    name: str,
    folder: str | Path,
    *,
    seed: int = 0,
    breaks: Sequence[str] = (),
    progress: Progress | None = None,
    scenarios: Mapping[str, Scenario] = SCENARIOS,
) -> Path:
    """Write the recording of scenario `name`, one of `scenarios`, into `folder`, and return the folder.

    It holds recording.toml, accel.csv, the other sensors' files, truth.csv (accelerometer's clock; zero at the first
    frame) and known.json (what an estimate should find). The same `seed` gives the same files. `breaks`: names of
    BREAKS, ways in which the sensors leave the model; the truth stays. `progress` is called with frames done and frames
    in all. Raises UsageError for an unknown name, a break that does not fit, or a folder with other content.
    """
    option("scenario", name, scenarios)
    target = Path(folder).resolve()
    check_free(target)
    progress = progress or (lambda done, total: None)
    staged, drawn = broken(stage(scenarios[name], seed), name, breaks, scenarios)
    duration_s = staged.scenario.duration_s
    with whole_folder(target) as partial:
        _write_acceleration(partial, staged)
        known = {
            "written_by": "midspan simulate",
            "scenario": name,
            "seed": seed,
            "accelerometer": {
                "noise_std_m_s2": staged.accelerometer.noise_std_m_s2,
                "bias_m_s2": staged.accelerometer.bias_m_s2,
            },
        }
        if drawn:
            known["broken"] = drawn
        if staged.scenario.free:
            known["chosen_here"] = staged.scenario.free
        if staged.scenario.camera is not None:
            known["camera"] = _write_camera(partial, staged, staged.scenario.camera, progress)
        if staged.scenario.gnss is not None:
            sensor, series = staged.scenario.gnss.sensor, staged.displacement(staged.scenario.gnss)
            columns = {"time_s": series.time_ns / 1e9, "height": 1e3 * series.value}
            write_table(partial / "gnss.csv", columns, decimals={"time_s": 6, "height": 4})
            known["displacement"] = {"noise_std_mm": 1e3 * sensor.noise_std_m, "time_offset_s": sensor.time_offset_s}
        _write_helping(partial, staged)
        if staged.scenario.radar is not None:
            known["radar"] = staged.scenario.radar.write(
                partial, staged.sensed, duration_s=duration_s, rng=staged.rng_radar, progress=progress
            )
        if staged.scenario.day is not None:
            known |= staged.scenario.day.write(
                partial, staged.sensed, duration_s=duration_s, rng=staged.rng_sensor, progress=progress
            )
        _write_truth(partial, staged)
        _write_settings(partial, staged)
        (partial / MARK).write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8")
    return target


def _write_helping(folder: Path, staged: Stage) -> None:
    """The files of a gyroscope and of a vibrometer."""
    if staged.scenario.gyroscope is not None:
        time_s, rate, _ = staged.rotation()
        write_table(folder / "gyro.csv", {"time_s": time_s, "gx": rate}, decimals={"time_s": 6, "gx": 7})
    if staged.scenario.vibrometer is not None:
        time_s, speed = staged.speed(staged.scenario.vibrometer)
        write_table(folder / "laser.csv", {"time_s": time_s, "v": speed}, decimals={"time_s": 6, "v": 6})


def _write_acceleration(folder: Path, staged: Stage) -> None:
    series = staged.acceleration()
    columns = {"time_s": series.time_ns / 1e9, "accel": series.value}
    if staged.across is not None and staged.scenario.camera is not None:
        main = staged.scenario.camera.direction
        columns[f"accel_{main}"] = columns.pop("accel")
        columns[f"accel_{_other(main)}"] = staged.acceleration(across=True).value
    if staged.scenario.gyroscope is not None:
        columns["accel_z"] = staged.rotation()[2]
    write_table(folder / "accel.csv", columns, decimals=dict.fromkeys(columns, 7) | {"time_s": 6})


def _other(axis: str) -> str:
    return "x" if axis == "y" else "y"


def _write_truth(folder: Path, staged: Stage) -> None:
    time, displacement, velocity = staged.truth_mm().T
    columns = {"time_s": time, "displacement_mm": displacement, "velocity_mm_s": velocity}
    decimals = {"time_s": 6, "displacement_mm": 7, "velocity_mm_s": 6}
    if staged.across is not None and staged.scenario.camera is not None:
        axis = _other(staged.scenario.camera.direction)
        names = (f"displacement_{axis}_mm", f"velocity_{axis}_mm_s")
        columns |= dict(zip(names, staged.truth_mm(staged.across).T[1:], strict=True))
        decimals |= {names[0]: 7, names[1]: 6}
    for name, values in staged.pose_truth().items():
        columns[name], decimals[name] = values, 7
    write_table(folder / "truth.csv", columns, decimals=decimals)


def _write_camera(folder: Path, staged: Stage, setup: CameraSetup, progress: Progress) -> dict[str, Any]:
    true_times = staged.frame_stamps_s(setup) + setup.time_offset_s
    stamps, posed = staged.written_stamps_s(setup), staged.posed_view(setup)
    if posed is None:
        view = staged.view(setup)
        film, known = view.film(staged.sensed, true_times, rng=staged.rng_sensor), _known(setup, view)
    else:
        film, known = posed.film(true_times, rng=staged.rng_sensor), _known_posed(posed)
    frames = (
        np.zeros_like(pixels) if black else pixels
        for pixels, black in zip(film, within(true_times, setup.black), strict=True)
    )
    lens = setup.fisheye
    write_video(
        folder / "camera.mkv",
        frames if lens is None else map(lens.whole, frames),
        stamps_s=stamps,
        rate_hz=setup.rate_hz,
        done=lambda count: progress(count, len(stamps)),
    )
    if not exact_in_video(stamps):
        write_table(folder / "camera_times.csv", {"time_s": stamps}, decimals={"time_s": 9})
    return known | {"time_offset_s": setup.time_offset_s}


def _known(setup: CameraSetup, view: View) -> dict[str, Any]:
    lens = setup.fisheye
    x_px, y_px = cramer_rao_std_px(view.scene, view.camera)
    region = Region(0, 0, view.scene.columns, view.scene.rows) if lens is None else lens.lit
    return {
        "scale_mm_per_px": setup.scale_mm_per_px,
        "cramer_rao_std_px": {"x": x_px, "y": y_px},
        "cramer_rao_region": [region.x, region.y, region.width, region.height],
    }


def _known_posed(view: PosedView) -> dict[str, Any]:
    bounds = [cramer_rao_std_px(plane.scene, view.camera) for plane in view.planes]
    return {
        "focal_px": view.focal_px,
        "distance_m": [plane.distance_m for plane in view.planes],
        "cramer_rao_std_px": {"x": [x for x, _ in bounds], "y": [y for _, y in bounds]},
    }


def _write_settings(folder: Path, staged: Stage) -> None:
    import tomli_w

    scenario = staged.scenario
    accelerometer = {"file": "accel.csv", "time": "time_s", "value": "accel", "unit": "m/s^2"}
    settings: dict[str, Any] = {"name": scenario.title, "accelerometer": accelerometer}
    if scenario.camera is not None:
        settings["camera"] = _camera_settings(staged, scenario.camera)
        if staged.across is not None:
            accelerometer.pop("value")
            settings["accelerometer"] = {**accelerometer, "value_x": "accel_x", "value_y": "accel_y"}
            settings["camera"]["direction"] = "xy"
    if scenario.gyroscope is not None:
        accelerometer.pop("value")
        settings["accelerometer"] = {**accelerometer, "value_y": "accel", "value_z": "accel_z"}
        settings["gyroscope"] = {"file": "gyro.csv", "time": "time_s", "value_x": "gx", "unit": "deg/s"}
        # One logger writes all; a nearly single tone fits at other offsets too.
        settings["calibration"] = {"max_offset_s": 0.1}
    if scenario.vibrometer is not None:
        settings["velocity"] = {"file": "laser.csv", "time": "time_s", "value": "v", "unit": "mm/s"}
    if scenario.gnss is not None:
        settings["displacement"] = {"file": "gnss.csv", "time": "time_s", "value": "height", "unit": "mm"}
        if scenario.gnss.white:
            settings["displacement"]["noise_time_s"] = 0
    if scenario.radar is not None:
        settings["radar"] = scenario.radar.settings()
    if scenario.day is not None:
        settings |= scenario.day.settings(scenario.duration_s)
    if scenario.window_s is not None:
        settings["calibration"] = {"window_s": list(scenario.window_s)}
    settings["reference"] = {"file": "truth.csv", "time": "time_s", "value": "displacement_mm", "unit": "mm"}
    (folder / "recording.toml").write_text(tomli_w.dumps(settings), encoding="utf-8")


def _camera_settings(staged: Stage, setup: CameraSetup) -> dict[str, Any]:
    settings: dict[str, Any] = {"file": "camera.mkv"}
    if not exact_in_video(staged.written_stamps_s(setup)):
        settings["times"] = "camera_times.csv"
    settings |= {"rate_hz": setup.rate_hz, "direction": setup.direction}
    if setup.says_exposure:
        settings["exposure_s"] = setup.camera.exposure_s
    if setup.every > 1:
        settings["every"] = setup.every
    if setup.camera.readout_s > 0:
        settings["readout_s"] = setup.camera.readout_s
    if setup.fisheye is not None:
        settings |= setup.fisheye.settings()
    if setup.targets:
        settings["target"] = [{"name": name, "roi": [r.x, r.y, r.width, r.height]} for name, r in setup.targets]
    for target, (distance_m, std_m) in zip(settings.get("target", ()), setup.declared_m, strict=False):
        target |= {"distance_m": distance_m, "distance_std_m": std_m}
    if setup.declared_m and staged.posed is not None:
        rows, columns = staged.posed.size_px
        settings["lens"] = {
            "matrix": [*[staged.posed.focal_px] * 2, 0.5 * (columns - 1), 0.5 * (rows - 1)],
            "distortion": [staged.posed.k1, 0.0, 0.0, 0.0],
            "size": [columns, rows],
        }
    return settings
