"""Real data (BROAD) through a rendered camera: a texture moved by the optical position, the real accelerometer."""

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import midspan
from benchmarks.broad import LIVELY, file, on_accelerometer_clock, streams
from benchmarks.cases import rms
from benchmarks.table import goal, show
from midspan.records import Floats
from midspan.signals.acceleration import GRAVITY_M_S2

MM_PER_PX, FRAMES_HZ = 10.0, 10.0
# The hand moves by a metre, a hundred pixels: the canvas does not repeat within the frame.
CANVAS, FRAME, COLUMNS = 640, 320, 96
CONTRAST_DN, NOISE_DN = 30.0, 1.5
# x, y, width, height: in the middle, so that the target stays in the frame.
ROI = [16, 128, 64, 64]
# Hand and plate lie on a table before and after, s.
LIVELY_S = 45.0, 145.0
WHOLE_S = 0.0, 180.0


@dataclass(frozen=True)
class Scored:
    """An axis of the recording over a span: errors in mm (also without what is in proportion
    to the displacement), the share of rows inside ±1.96 σ, and the scale factor."""

    axis: str
    cubic_mm: float
    rms_mm: float
    without_scale_mm: float
    worst_mm: float
    inside: float
    scale: float
    scale_std: float

    @property
    def ratio(self) -> float:
        """Error over that of the cubic."""
        return self.rms_mm / self.cubic_mm

    @property
    def scale_z(self) -> float:
        """Standard deviations between the scale factor and the true one."""
        return (self.scale + MM_PER_PX) / self.scale_std

    @property
    def row(self) -> list[object]:
        """What the table shows."""
        scale = (self.scale, self.scale_std, self.scale_z)
        return [
            self.axis,
            self.cubic_mm,
            self.rms_mm,
            self.ratio,
            self.without_scale_mm,
            self.worst_mm,
            self.inside,
            *scale,
        ]


def texture(rng: np.random.Generator) -> NDArray[np.complex128]:
    """Spectrum along the rows of a texture (CANVAS, COLUMNS) of standard deviation 1, like 1/f, blurred by 0.8 px."""
    f = np.hypot(np.fft.fftfreq(CANVAS)[:, None], np.fft.fftfreq(COLUMNS)[None, :])
    blur = np.exp(-2 * (np.pi * 0.8 * f) ** 2) / np.maximum(f, 1 / 24) * (f > 0) * (f < 0.5)
    drawn = np.fft.ifft2(np.fft.fft2(rng.normal(size=f.shape)) * blur).real
    return np.asarray(np.fft.rfft(drawn / np.std(drawn), axis=0))


def film(moved_px: Floats, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Frames (n, FRAME, COLUMNS) of 8 bits of the texture moved down by this many pixels (n,), with noise."""
    spectrum, turns = texture(rng), np.fft.rfftfreq(CANVAS)
    part = slice((CANVAS - FRAME) // 2, (CANVAS + FRAME) // 2)
    stack = np.empty((len(moved_px), FRAME, COLUMNS), dtype=np.uint8)
    for k, moved in enumerate(moved_px):
        shifted = np.fft.irfft(spectrum * np.exp(-2j * np.pi * turns * moved)[:, None], CANVAS, axis=0)[part]
        noisy = 120 + CONTRAST_DN * shifted + rng.normal(0, NOISE_DN, shifted.shape)
        stack[k] = np.clip(np.rint(noisy), 0, 255)
    return stack


def written(folder: Path, time: Floats, acceleration: Floats, position: Floats, axis: int) -> tuple[Floats, Floats]:
    """The recording's files from accelerations (n, 3) and the position (n,) along an axis.

    Returns the frames' instants (s) and true positions (m).
    """
    known = np.isfinite(position)
    wanted = np.arange(time[0] + 0.05, time[-1], 1 / FRAMES_HZ)
    met = time[np.searchsorted(time, wanted)]
    seen = CubicSpline(time[known], position[known])(met)
    np.savez(folder / "camera.npz", frames=film(-1e3 * seen / MM_PER_PX, np.random.default_rng(axis)))
    np.savetxt(folder / "times.csv", met, "%.9f", header="time_s", comments="")
    # The upright axis feels gravity, which is taken off the streams.
    accel = np.column_stack((time, acceleration + np.array([0.0, 0.0, GRAVITY_M_S2])))
    np.savetxt(folder / "accel.csv", accel, "%.9f", ",", header="time_s,E,N,U", comments="")
    return met, seen


def recorded(axis: int, more: str) -> str:
    """The recording's settings: nothing but what is in the files; more: lines of [accelerometer]."""
    return (
        f'[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "{"ENU"[axis]}"\nunit = "m/s^2"\n'
        f'{more}\n[camera]\nfile = "camera.npz"\ntimes = "times.csv"\ndirection = "y"\nroi = {ROI}\n'
    )


def others(axis: int) -> str:
    """The accelerometer's other axes as its settings name them."""
    return f"cross_values = {[name for name in 'ENU' if name != 'ENU'[axis]]}"


def through_the_camera(
    path: Path, axis: int, span_s: tuple[float, float], more: str = "", method: str = "smoother"
) -> Scored:
    """One axis of the recording between two instants (s) through `midspan.estimate`; judged where it is lively."""
    time, acceleration, position = streams(path)
    part = slice(*np.searchsorted(time, span_s))
    time, felt, position = time[part], acceleration[part], position[part, axis]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        met, seen = written(folder, time, felt, position, axis)
        (folder / "recording.toml").write_text(recorded(axis, more))
        result = midspan.estimate(midspan.open_recording(folder), method=method)
    camera = result.calibration.camera
    truth = on_accelerometer_clock(time, position, camera.offset.value_s) - seen[0]
    truth = np.interp(result.time_s, time, truth)
    cubic = CubicSpline(met + camera.offset.value_s, seen)(result.time_s) - seen[0] - truth
    error = 1e-3 * result.displacement_mm - truth
    judged = np.isfinite(error) & (result.time_s > LIVELY_S[0] + 2) & (result.time_s < LIVELY_S[1] - 2)
    share = float(truth[judged] @ error[judged] / (truth[judged] @ truth[judged]))
    inside = np.abs(error[judged]) < 1.96e-3 * result.displacement_std_mm[judged]
    return Scored(
        "ENU"[axis],
        1e3 * rms(cubic[judged]),
        1e3 * rms(error[judged]),
        1e3 * rms(error[judged] - share * truth[judged]),
        1e3 * float(np.max(np.abs(error[judged]))),
        float(np.mean(inside)),
        1e3 * camera.scale.value_m_per_px,
        1e3 * float(np.sqrt(camera.scale.variance)),
    )


def main() -> None:
    path = file(LIVELY)
    if path is None:
        print(f"skipped: {LIVELY} not found; set MIDSPAN_DATA to the folder that holds broad/")
        return
    head = ["axis", "cubic mm", "midspan mm", "over cubic", "no scale", "worst mm", "in 95 % band", "scale", "std", "z"]
    settings = {
        "default": lambda axis: "",
        "scale_std = 0.005": lambda axis: "scale_std = 0.005",
        "cross_values": others,
    }
    for name, span_s in (("lively part", LIVELY_S), ("whole", WHOLE_S)):
        for words, more in settings.items():
            for method in ("smoother", "kalman"):
                found = [through_the_camera(path, axis, span_s, more(axis), method) for axis in range(3)]
                print(f"{name}, {words}, {method}:")
                show(head, [one.row for one in found])
                if method == "kalman":
                    continue
                for one in found:
                    text = f"{name}, {words}, axis {one.axis}"
                    goal(f"{text}: error over cubic", one.ratio, 0.4)
                    goal(f"{text}: the same without the scale's error", one.without_scale_mm / one.cubic_mm, 0.4)
                    goal(f"{text}: inside", one.inside, 0.9, at_least=True)
                    goal(f"{text}: scale, standard deviations off", abs(one.scale_z), 3.0)


if __name__ == "__main__":
    main()
