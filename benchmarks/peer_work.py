"""One library's work on a stack of frames or on a record: `python benchmarks/peer_work.py NAME FOLDER`.

Runs in the environment of the library it names, which need not have midspan. It reads what `benchmarks.peers` wrote
into FOLDER, works once on a small part (whatever is compiled or loaded is then there), then once on the whole, writes
what it found to NAME.npy and prints processor time, peak memory and version as JSON.
"""

import importlib.metadata
import json
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

REGION_PX, CORNER_PX, SEARCH_PX = 128, (32, 56), 8  # side; y, x
FAST_HZ, EVERY = 100.0, 10
CUT_OFF_HZ, TAPS = 1.0, 501
WARM_FRAMES, WARM_SAMPLES = 50, 200


def midspan_track(folder: Path, warm: bool) -> np.ndarray:
    from midspan.recording.tracking.track import track
    from midspan.records import Region

    region = Region(CORNER_PX[1], CORNER_PX[0], REGION_PX, REGION_PX)
    found = track(folder / ("warm.npy" if warm else "stack.npy"), roi=region, rate_hz=FAST_HZ).track
    return np.stack([found.x_px, found.y_px], axis=1)


def opencv(folder: Path, warm: bool) -> np.ndarray:
    """Zero-mean normalised correlation over the neighbourhood, a parabola along each axis."""
    import cv2

    cv2.setNumThreads(1)
    (y, x), side, n = CORNER_PX, REGION_PX, SEARCH_PX
    stack = _stack(folder, warm)
    template, rows = np.array(stack[0][y : y + side, x : x + side]), []
    for image in stack:
        part = np.array(image)[y - n : y + side + n, x - n : x + side + n]
        surface = cv2.matchTemplate(part, template, cv2.TM_CCOEFF_NORMED)
        _, _, _, (i, j) = cv2.minMaxLoc(surface)
        rows.append((i - n + _peak(*surface[j, i - 1 : i + 2]), j - n + _peak(*surface[j - 1 : j + 2, i])))
    return np.array(rows)


def scikit_image(folder: Path, warm: bool) -> np.ndarray:
    """Up-sampled cross-correlation to 1/100 px."""
    from skimage.registration import phase_cross_correlation

    (y, x), side = CORNER_PX, REGION_PX
    stack = _stack(folder, warm)
    parts = stack[:, y : y + side, x : x + side].astype(np.float64)
    found = [phase_cross_correlation(parts[0], one, upsample_factor=100, normalization=None)[0] for one in parts]
    return -np.array(found)[:, ::-1]


def pyidi(folder: Path, warm: bool) -> np.ndarray:
    """Its Lucas-Kanade method on one subset, which has to be of odd size."""
    from pyidi import LucasKanade, VideoReader

    method = LucasKanade(VideoReader(input_file=np.array(_stack(folder, warm)), root=str(folder), fps=FAST_HZ))
    method.set_points(np.array([[CORNER_PX[0] + REGION_PX // 2, CORNER_PX[1] + REGION_PX // 2]]))
    method.configure(roi_size=(REGION_PX - 1, REGION_PX - 1), verbose=0, show_pbar=False)
    return np.asarray(method.get_displacements(autosave=False))[0][:, ::-1]


def midspan_kalman(folder: Path, warm: bool) -> np.ndarray:
    return _midspan(folder, warm, "kalman")


def midspan_smoother(folder: Path, warm: bool) -> np.ndarray:
    return _midspan(folder, warm, "smoother")


def filterpy(folder: Path, warm: bool) -> np.ndarray:
    """Three states (displacement, velocity, bias) and its Rauch-Tung-Striebel pass."""
    from filterpy.kalman import KalmanFilter

    model = KalmanFilter(dim_x=3, dim_z=1)
    transition, noise, variance, pushes, met = _model(folder, warm)
    model.F, model.Q, model.R, model.H = transition, noise, np.array([[variance]]), np.array([[1.0, 0.0, 0.0]])
    model.x, model.P = np.array([met[0], 0.0, 0.0]), START
    means, covariances = [], []
    for k in range(len(met)):
        if k:
            model.predict()
            model.x = model.x + pushes[k - 1]
        if np.isfinite(met[k]):
            model.update(met[k])
        means.append(model.x.copy())
        covariances.append(model.P.copy())
    # Its backward pass knows no input: what the input moved is taken out first and put back afterwards.
    moved = np.zeros((len(met), 3))
    for k in range(1, len(met)):
        moved[k] = transition @ moved[k - 1] + pushes[k - 1]
    return (model.rts_smoother(np.array(means) - moved, np.array(covariances))[0] + moved)[:, 0]


def pykalman(folder: Path, warm: bool) -> np.ndarray:
    """The same model by its `smooth`."""
    from pykalman import KalmanFilter

    transition, noise, variance, pushes, met = _model(folder, warm)
    model = KalmanFilter(
        transition, np.array([[1.0, 0.0, 0.0]]), noise, np.array([[variance]]), pushes,
        initial_state_mean=np.array([met[0], 0.0, 0.0]), initial_state_covariance=START,
    )  # fmt: skip
    return np.asarray(model.smooth(np.ma.masked_invalid(met)[:, None])[0])[:, 0]


def statsmodels(folder: Path, warm: bool) -> np.ndarray:
    """The same model by its compiled `KalmanSmoother`."""
    from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

    transition, noise, variance, pushes, met = _model(folder, warm)
    model = KalmanSmoother(k_endog=1, k_states=3)
    model.bind(met[:, None].copy())
    model["design"], model["transition"], model["selection"] = np.array([[1.0, 0.0, 0.0]]), transition, np.eye(3)
    model["state_cov"], model["obs_cov"] = noise, np.array([[variance]])
    model["state_intercept"] = np.vstack([pushes, np.zeros(3)]).T.copy()
    model.initialize_known(np.array([met[0], 0.0, 0.0]), START)
    return np.asarray(model.smooth().smoothed_state[0])


def scipy_fir(folder: Path, warm: bool) -> np.ndarray:
    """Two complementary FIR filters, forwards and backwards: the doubly integrated acceleration above, the interpolated
    displacement below the cut-off.
    """
    from scipy.integrate import cumulative_trapezoid
    from scipy.interpolate import CubicSpline
    from scipy.signal import detrend, filtfilt, firwin

    accel, met = _record(folder, warm)
    low = firwin(min(TAPS, 2 * (len(accel) // 8) + 1), CUT_OFF_HZ, fs=FAST_HZ)
    speed = detrend(cumulative_trapezoid(accel, dx=1 / FAST_HZ, initial=0.0))
    moved = detrend(cumulative_trapezoid(speed, dx=1 / FAST_HZ, initial=0.0))
    index = np.arange(len(accel))
    slow = CubicSpline(index[::EVERY], met[::EVERY])(index)
    return np.asarray(moved - filtfilt(low, 1.0, moved) + filtfilt(low, 1.0, slow))


def scipy_fft(folder: Path, warm: bool) -> np.ndarray:
    """Spectra put together at the cut-off: the acceleration's over -ω² above it, the displacement's below."""
    from scipy.fft import irfft, rfft, rfftfreq
    from scipy.interpolate import CubicSpline

    accel, met = _record(folder, warm)
    index = np.arange(len(accel))
    slow = rfft(CubicSpline(index[::EVERY], met[::EVERY])(index))
    speed = 2 * np.pi * rfftfreq(len(accel), 1 / FAST_HZ)
    above = speed > 2 * np.pi * CUT_OFF_HZ
    slow[above] = -rfft(accel)[above] / speed[above] ** 2
    return np.asarray(irfft(slow, len(accel)))


START = np.diag([1e-6, 1e-2, 1e-4])
BIAS_WALK = 1e-10  # m²/s⁵
WORKS: dict[str, tuple[Callable[[Path, bool], np.ndarray], str]] = {
    "midspan track": (midspan_track, "midspan"),
    "OpenCV ZNCC and parabola": (opencv, "opencv-contrib-python"),
    "scikit-image phase correlation": (scikit_image, "scikit-image"),
    "pyidi Lucas-Kanade": (pyidi, "pyidi"),
    "midspan kalman": (midspan_kalman, "midspan"),
    "midspan smoother": (midspan_smoother, "midspan"),
    "filterpy RTS": (filterpy, "filterpy"),
    "pykalman smooth": (pykalman, "pykalman"),
    "statsmodels KalmanSmoother": (statsmodels, "statsmodels"),
    "SciPy FIR": (scipy_fir, "scipy"),
    "SciPy FFT": (scipy_fft, "scipy"),
}


def _stack(folder: Path, warm: bool) -> np.ndarray:
    return np.asarray(np.load(folder / ("warm.npy" if warm else "stack.npy"), mmap_mode="r"))


def _record(folder: Path, warm: bool) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration (n,) in m/s² and displacement (n,) in m, NaN between its measurements."""
    kept = np.load(folder / "record.npz")
    count = WARM_SAMPLES if warm else len(kept["accel"])
    return kept["accel"][:count], kept["displacement"][:count]


def _model(folder: Path, warm: bool) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
    """Transition, its noise, a measurement's variance, what each interval's acceleration adds (n - 1, 3), record."""
    accel, met = _record(folder, warm)
    dt = 1 / FAST_HZ
    kept = np.load(folder / "record.npz")
    density = float(kept["accel_std"]) ** 2 * dt
    transition = np.array([[1.0, dt, -dt * dt / 2], [0.0, 1.0, -dt], [0.0, 0.0, 1.0]])
    noise = density * np.array([[dt**3 / 3, dt**2 / 2, 0], [dt**2 / 2, dt, 0], [0, 0, 0]])
    noise[2, 2] = BIAS_WALK * dt
    # The acceleration runs straight from sample to sample.
    before, after = accel[:-1], accel[1:]
    pushes = np.column_stack((dt**2 * (before / 3 + after / 6), dt * (before + after) / 2, np.zeros(len(before))))
    return transition, noise, float(kept["displacement_std"]) ** 2, pushes, met


def _midspan(folder: Path, warm: bool, method: str) -> np.ndarray:
    from midspan.fusion.runners import run_method
    from midspan.records import Acceleration, Displacement, Source

    accel, met = _record(folder, warm)
    kept = np.load(folder / "record.npz")
    time_ns = np.round(1e9 * np.arange(len(accel)) / FAST_HZ).astype(np.int64)
    seen = np.flatnonzero(np.isfinite(met))
    density = np.full(len(accel), float(kept["accel_std"]) ** 2 / FAST_HZ)
    variance, source = np.full(len(seen), float(kept["displacement_std"]) ** 2), np.full(len(seen), Source.DISPLACEMENT)
    measured = Displacement(time_ns[seen], met[seen], variance, source.astype(np.uint8))
    return run_method(method, Acceleration(time_ns, accel, density), measured).estimate.displacement_m


def _peak(before: float, at: float, after: float) -> float:
    """Where the parabola through three values is largest, from the middle one."""
    return 0.5 * (before - after) / (before - 2 * at + after)


def _peak_mb() -> float:
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))


def main(name: str, folder: Path) -> None:
    warnings.simplefilter("ignore")
    work, library = WORKS[name]
    work(folder, True)
    begun_s = time.process_time()
    found = work(folder, False)
    took_s = time.process_time() - begun_s
    np.save(folder / f"{name}.npy", found)
    if library == "opencv-contrib-python" and not _installed(library):
        library += "-headless"
    print(json.dumps({"took_s": took_s, "peak_mb": _peak_mb(), "version": importlib.metadata.version(library)}))


def _installed(library: str) -> bool:
    try:
        importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
