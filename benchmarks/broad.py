"""Real data (BROAD): hand-moved accelerometer and optical position; smoother against cubic interpolation."""

import os
import tempfile
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import midspan
from benchmarks.cases import blocks, estimated, fused, rms
from benchmarks.table import goal, show
from midspan.records import Floats, TimeSeries, nanoseconds

FILE, LIVELY = "10_undisturbed_slow_translation_A.hdf5", "15_undisturbed_fast_translation_A.hdf5"
NOISE_M, SLOW_HZ = 1e-3, 10.0
# Rate (Hz) and noise (m) of the slow sensor in lively motion, and what its error may be of that of the cubic at most.
CASES = ((10.0, 1e-3, 0.65), (10.0, 5e-5, 0.65), (3.0, 1e-3, 0.2))
INSIDE, OVERRULED_S = (0.92, 0.97), 0.3
# A row is coasting once this many intervals passed without a measurement that was accepted.
COASTING = 2.5


def file(name: str) -> Path | None:
    """The recording under MIDSPAN_DATA or next to the repository."""
    places = [os.environ.get("MIDSPAN_DATA"), Path(__file__).parents[2] / "shared" / "data"]
    found = [Path(place) / "broad" / name for place in places if place]
    return next((path for path in found if path.exists()), None)


def rotated(quaternion: Floats, vector: Floats) -> Floats:
    """Vectors (n, 3) of the sensor in the frame that the unit quaternions (n, 4) w, x, y, z lead to."""
    w, u = quaternion[:, :1], quaternion[:, 1:]
    turned = 2.0 * np.cross(u, vector)
    return vector + w * turned + np.cross(u, turned)


def streams(path: Path) -> tuple[Floats, Floats, Floats]:
    """Time (n,) s, acceleration (n, 3) m/s² in ENU without its mean, position (n, 3) m with NaN where none."""
    import h5py

    with h5py.File(path) as data:
        rate = float(data.attrs["sampling_rate"])
        acceleration, quaternion, position = (data[name][:] for name in ("imu_acc", "opt_quat", "opt_pos"))
    time = np.arange(len(acceleration)) / rate
    known = np.isfinite(quaternion).all(axis=1)
    filled = np.column_stack([np.interp(time, time[known], column[known]) for column in quaternion.T])
    filled /= np.linalg.norm(filled, axis=1)[:, None]
    turned = rotated(filled, acceleration)
    return time, turned - np.mean(turned, axis=0), position


def camera_of(
    time: Floats, position: Floats, axis: int, noise_m: float = NOISE_M, rate_hz: float = SLOW_HZ
) -> tuple[Floats, Floats]:
    """The stand-in for a camera: the optical position at a rate, with noise."""
    step = (time[1] - time[0]) ** -1 / rate_hz
    index = np.rint(np.arange(0, len(time) - 1, step)).astype(int)
    noise = np.random.default_rng(axis).normal(0, noise_m, len(index))
    return time[index], position[index, axis] + noise


def on_accelerometer_clock(time: Floats, value: Floats, offset_s: float) -> Floats:
    """The optical position (n,) at the accelerometer's instants.

    Reference and camera stand-in come from one optical system, so they share its clock; all three axes find that the
    recording's "synchronised" accelerometer is 2.5 ms away from it. At 0.4 m/s that is a millimetre.
    """
    known = np.isfinite(value)
    moved = CubicSpline(time[known] + offset_s, value[known])(time)
    far = np.interp(time, time[known] + offset_s, np.r_[0.0, np.diff(time[known])]) > 0.02
    return np.where(far, np.nan, moved)


def compared(path: Path, axis: int) -> list[object]:
    """One row of the table for an axis; nothing but the two streams is used."""
    time, acceleration, position = streams(path)
    met, value = camera_of(time, position, axis)
    a = TimeSeries(nanoseconds(time), acceleration[:, axis])
    d = TimeSeries(nanoseconds(met), value)
    fit = estimated(a, d, 0.2)
    pair = blocks(a, d, fit.input_noise.density, fit.variance_factor, fit.offset.value_s)
    usable = np.isfinite(value)
    estimate = fused(*pair, "smoother")
    near = np.interp(time, met[usable], np.r_[0.0, np.diff(met[usable])]) < 0.15
    compare = np.isfinite(position[:, axis]) & near & (time > met[usable][0] + 2) & (time < met[usable][-1] - 2)
    cubic = CubicSpline(met[usable], value[usable])(time) - position[:, axis]
    ours = estimate.displacement_m - on_accelerometer_clock(time, position[:, axis], fit.offset.value_s)
    compare &= np.isfinite(ours)
    ratio = rms(cubic[compare]) / rms(ours[compare])
    inside = float(np.mean(np.abs(ours[compare]) < 1.96 * np.sqrt(estimate.variance_m2[compare])))
    # As the file says, both clocks equal: no offset applied, the reference as it stands.
    plain = fused(*blocks(a, d, fit.input_noise.density, fit.variance_factor), "smoother").displacement_m
    equal = rms(cubic[compare]) / rms((plain - position[:, axis])[compare])
    noise = (equal, 1e3 * np.sqrt(fit.variance_factor), 1e3 * fit.offset.value_s, fit.scale)
    return ["ENU"[axis], 1e3 * rms(cubic[compare]), 1e3 * rms(ours[compare]), ratio, inside, *noise]


def through_the_front_door(path: Path, axis: int, noise_m: float = NOISE_M, rate_hz: float = SLOW_HZ) -> list[object]:
    """The same as a recording on disk through `midspan.estimate`."""
    time, acceleration, position = streams(path)
    met, value = camera_of(time, position, axis, noise_m, rate_hz)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savetxt(folder / "accel.csv", np.column_stack((time, acceleration[:, axis])), "%.9f", ",",
                   header="time_s,accel", comments="")  # fmt: skip
        np.savetxt(folder / "optical.csv", np.column_stack((met, 1e3 * value)), "%.9f", ",",
                   header="time_s,height", comments="")  # fmt: skip
        (folder / "recording.toml").write_text(
            '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
            '[displacement]\nfile = "optical.csv"\ntime = "time_s"\nvalue = "height"\nunit = "mm"\n'
            "estimate_offset = true\n"
            "[calibration]\nmax_offset_s = 0.2\n"
        )
        result = midspan.estimate(midspan.open_recording(folder))
    truth = np.interp(result.time_s, time, position[:, axis])
    cubic = CubicSpline(met[np.isfinite(value)], value[np.isfinite(value)])(result.time_s) - truth
    # Where the optical position is known the sensor is sound: what passed between measurements that were accepted.
    known = np.isfinite(truth) & (np.interp(result.time_s, met, np.isnan(value)) == 0.0)
    overruled_s = longest_s(known & (result.estimate.status != 0), result.time_s)
    compare = np.isfinite(truth) & (result.estimate.status == 0) & (result.time_s > 2) & (result.time_s < time[-1] - 2)
    offset = result.calibration.displacement.offset.value_s
    moved = on_accelerometer_clock(time, position[:, axis], offset)
    ours = 1e-3 * result.displacement_mm - np.interp(result.time_s, time, moved)
    compare &= np.isfinite(ours)
    inside = float(np.mean(np.abs(ours[compare]) < 1.96e-3 * result.displacement_std_mm[compare]))
    return [
        "ENU"[axis],
        1e3 * rms(cubic[compare]),
        1e3 * rms(ours[compare]),
        rms(cubic[compare]) / rms(ours[compare]),
        inside,
        overruled_s + COASTING / rate_hz if overruled_s else 0.0,
    ]


def longest_s(held: np.ndarray, time_s: Floats) -> float:
    """The longest time for which something holds (n,) without a break, s."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], held, [0]))))
    return float(max((time_s[end - 1] - time_s[first] for first, end in edges.reshape(-1, 2)), default=0.0))


def main() -> None:
    path, lively = file(FILE), file(LIVELY)
    if path is None or lively is None:
        print(f"skipped: {FILE} or {LIVELY} not found; set MIDSPAN_DATA to the folder that holds broad/")
        return
    rows = [compared(path, axis) for axis in range(3)]
    head = ["axis", "cubic mm", "smoother mm", "times better", "in 95 % band"]
    show([*head, "clocks equal", "noise learned mm", "offset ms", "scale"], rows)
    doors = [through_the_front_door(path, axis) for axis in range(3)]
    print("the same through midspan.estimate:")
    show([*head, "overruled s"], doors)
    for row in doors:
        goal(f"axis {row[0]}: times better than cubic interpolation", float(row[3]), 1.4, at_least=True)
    for rate_hz, noise_m, least in CASES:
        doors = [through_the_front_door(lively, axis, noise_m, rate_hz) for axis in range(3)]
        print(f"lively motion, through midspan.estimate, {rate_hz:g} Hz, noise of {1e3 * noise_m:g} mm:")
        show([*head, "overruled s"], doors)
        for row in doors:
            what = f"lively, {rate_hz:g} Hz, {1e3 * noise_m:g} mm, axis {row[0]}"
            goal(f"{what}: error over cubic", 1.0 / float(row[3]), least)
            goal(f"{what}: inside", float(row[4]), INSIDE[0], at_least=True)
            goal(f"{what}: inside", float(row[4]), INSIDE[1])
            goal(f"{what}: sound measurements overruled for", float(row[5]), OVERRULED_S, unit="s")


if __name__ == "__main__":
    main()
