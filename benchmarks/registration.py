"""Registration tracker against its bound and its goals, compared with matchTemplate with a parabola and
scikit-image."""

import time
from collections.abc import Callable
from itertools import count, cycle

import numpy as np

from benchmarks.table import goal, show
from midspan.records import Floats, Frame, Prediction, Region
from midspan.simulate.scene.camera import Camera, Pixels, cramer_rao_std_px
from midspan.simulate.scene.scene import Scene
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.registration import RegistrationSettings, RegistrationTracker

SIDE, REFERENCES, ESTIMATED, FRAMES = 200, 16, 52, 16
MIDDLE = SIDE / 2 - 0.5
ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE] - MIDDLE
CAMERA, NEAR = Camera(), Prediction(0.0, 0.0, 0.4, 0.4)
LIMITS = {"natural": (1.2, 0.001), "blocks": (1.2, 0.001), "facade": (1.5, 0.001), "weak": (1.5, 0.003)}


def middle(size: int) -> Region:
    """The square region in the middle of the picture."""
    return Region((SIDE - size) // 2, (SIDE - size) // 2, size, size)


def parabola(reference: Pixels, image: Pixels, region: Region) -> tuple[float, float]:
    """OpenCV's normalised correlation over ±3 px and a parabola through three values along each axis."""
    import cv2

    x, y, w, h = region.x, region.y, region.width, region.height
    part = image[y - 3 : y + h + 3, x - 3 : x + w + 3]
    surface = cv2.matchTemplate(part, reference[y : y + h, x : x + w], cv2.TM_CCOEFF_NORMED)
    _, _, _, (i, j) = cv2.minMaxLoc(surface)

    def peak(before: float, at: float, after: float) -> float:
        return 0.5 * (before - after) / (before - 2 * at + after)

    if not (0 < i < 6 and 0 < j < 6):
        return np.nan, np.nan
    return i - 3 + peak(*surface[j, i - 1 : i + 2]), j - 3 + peak(*surface[j - 1 : j + 2, i])


def upsampled(reference: Pixels, image: Pixels, region: Region) -> tuple[float, float]:
    """scikit-image's up-sampled cross-correlation to 1/100 px."""
    from skimage.registration import phase_cross_correlation

    part = np.s_[region.y : region.y + region.height, region.x : region.x + region.width]
    found, _, _ = phase_cross_correlation(image[part], reference[part], upsample_factor=100, normalization=None)
    return float(found[1]), float(found[0])


def scatter(scene: Scene, region: Region) -> tuple[dict[str, float], float]:
    """Scatter (px, both axes) by method, and reported over true deviation of the tracker."""
    rng = np.random.default_rng(1)
    errors: dict[str, list[Floats]] = {"registration": [], "matchTemplate": [], "scikit-image": []}
    variance = []
    for _ in range(REFERENCES):
        reference = CAMERA.expose(scene.render(0, 0), rng=rng)
        tracker = RegistrationTracker(Frame(0, reference), region, RegistrationSettings())
        rows: dict[str, list[tuple[float, float]]] = {name: [] for name in errors}
        for k, (x, y) in enumerate(rng.uniform(-0.6, 0.6, (ESTIMATED + FRAMES, 2))):
            image = CAMERA.expose(scene.render(x, y), rng=rng)
            found = tracker.push(Frame((k + 1) * 10**7, image), NEAR)
            if k < ESTIMATED:
                continue
            rows["registration"].append((found.x_px - x, found.y_px - y))
            variance.append((found.variance_x_px2, found.variance_y_px2))
            for name, method in (("matchTemplate", parabola), ("scikit-image", upsampled)):
                fx, fy = method(reference, image, region)
                rows[name].append((fx - x, fy - y))
        for name, values in rows.items():
            errors[name].append(np.array(values))
    true = float(np.sqrt(np.mean(np.square(errors["registration"]))))
    spread = {
        name: float(np.sqrt(np.nanmean([np.nanvar(e, axis=0, ddof=1) for e in es]))) for name, es in errors.items()
    }
    return spread, float(np.sqrt(np.mean(variance))) / true


def systematic(scene: Scene, region: Region) -> float:
    """Largest error (px) over the phases, without noise, of what was learned; the zero, one frame's, is taken off."""
    rng = np.random.default_rng(3)
    tracker = RegistrationTracker(Frame(0, scene.render(0, 0)), region, RegistrationSettings(learn_frames=0))
    tracker.learn(
        [Frame((k + 1) * 10**7, scene.render(*p)) for k, p in enumerate(rng.uniform(-0.5, 0.5, (ESTIMATED, 2)))]
    )
    places = np.array([(k / 24 - 0.5, (7 * k % 24) / 24 - 0.5) for k in range(24)])
    found = [tracker.push(Frame((k + 1) * 10**7, scene.render(*p)), NEAR) for k, p in enumerate(places)]
    error = np.array([(f.x_px, f.y_px) for f in found]) - places
    return float(np.abs(error - error.mean(axis=0)).max())


def turned(image: Floats, roll_rad: float, zoom: float) -> Floats:
    """The image turned and enlarged about its middle."""
    from scipy.ndimage import map_coordinates, spline_filter

    a, b = 1 + zoom, roll_rad
    x, y = (a * COLUMNS + b * ROWS) / (a * a + b * b), (a * ROWS - b * COLUMNS) / (a * a + b * b)
    spline = spline_filter(image.astype(np.float64), 5, mode="mirror")
    return np.asarray(map_coordinates(spline, [y + MIDDLE, x + MIDDLE], order=5, prefilter=False, mode="mirror"))


def covered(image: Floats, top: float, left: float, right: float, size: int) -> Floats:
    """The image with a bright object over a part of the region, edges as shares of its `size`."""
    start, image = (SIDE - size) // 2, image.copy()
    rows = slice(start + int(top * size), start + int((1 - top) * size))
    image[rows, start + int(left * size) : start + int(right * size)] = 200.0
    return image


def disturbances(size: int) -> dict[str, Callable[[Floats], Floats]]:
    """One disturbance at a time, of a region of `size` px in the middle."""
    return {
        "ramp 30 %": lambda im: im * (1 + 0.3 * COLUMNS / (size / 2)),
        "shadow 40 %": lambda im: im * np.where(COLUMNS > 3, 0.6, 1.0),
        "gain 0.6": lambda im: 0.6 * im + 20,
        "side 40 %": lambda im: covered(im, 0.0, 0.0, 0.4, size),
        "middle 40 %": lambda im: covered(im, 0.18, 0.18, 0.82, size),
        "roll 0.5°": lambda im: turned(im, np.deg2rad(0.5), 0.0),
        "zoom 0.3 %": lambda im: turned(im, 0.0, 0.003),
    }


def disturbed(scene: Scene, region: Region) -> dict[str, tuple[float, float]]:
    """RMS (px) of what each disturbance moves a noise-free frame by, and the reported deviation."""
    rng = np.random.default_rng(4)
    tracker = RegistrationTracker(Frame(0, CAMERA.expose(scene.render(0, 0), rng=rng)), region, RegistrationSettings())
    for k, p in enumerate(rng.uniform(-0.6, 0.6, (ESTIMATED, 2))):
        tracker.push(Frame((k + 1) * 10**7, CAMERA.expose(scene.render(*p), rng=rng)), NEAR)
    begin, result = tracker.state, {}
    places = rng.uniform(-0.05, 0.05, (6, 2))
    for name, change in disturbances(region.width).items():
        rows, variance = [], []
        for x, y in places:
            found = []
            for image in (scene.render(x, y), change(scene.render(x, y)).astype(np.float32)):
                tracker.restore(begin)
                found.append(tracker.push(Frame(10**10, image), NEAR))
            rows.append((found[1].x_px - found[0].x_px, found[1].y_px - found[0].y_px))
            variance.append((found[1].variance_x_px2, found[1].variance_y_px2))
        result[name] = float(np.sqrt(np.mean(np.square(rows)))), float(np.sqrt(np.mean(variance)))
    return result


def rate(work: Callable[[], object], repeats: int) -> float:
    """Calls a second, the best of three rounds."""
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        for _ in range(repeats):
            work()
        best = min(best, time.perf_counter() - start)
    return repeats / best


def speeds(scene: Scene) -> None:
    """Kernel and whole tracker at 128 px, one thread."""
    import cv2

    cv2.setNumThreads(1)
    rng, region = np.random.default_rng(2), middle(128)
    reference, image = (CAMERA.expose(scene.render(d, -d), rng=rng) for d in (0.0, 0.02))
    tracker = RegistrationTracker(Frame(0, reference), region, RegistrationSettings(learn_frames=0))
    tracker.push(Frame(1, image), NEAR)
    kernel = rate(lambda: tracker.core.look(image, (0.0, 0.0)), 1000)
    rows: list[list[object]] = [["from pixels to a pose", kernel]]
    goal("from pixels to a pose", kernel, 30_000, unit="regions/s", at_least=True)
    places = [(0.8 * np.sin(k / 3), 0.5 * np.cos(k / 4)) for k in range(40)]
    images = [CAMERA.expose(scene.render(*p), rng=rng) for p in places]
    times = count(10**7, 10**7)
    moving, known = cycle(images), cycle(zip(images, (Prediction(*p, 0.1, 0.1) for p in places), strict=True))

    def predicted() -> None:
        image, prediction = next(known)
        tracker.push(Frame(next(times), image), prediction)

    ours = rate(predicted, 300)
    alone = rate(lambda: tracker.push(Frame(next(times), next(moving))), 300)
    peer = rate(lambda: parabola(reference, image, region), 50)
    rows += [
        ["push, moving, predicted", ours],
        ["push, moving, no prediction", alone],
        ["matchTemplate", peer],
        ["scikit-image", rate(lambda: upsampled(reference, image, region), 20)],
    ]
    show(["128 px, one thread", "regions/s"], rows)
    goal("push against matchTemplate and parabola", ours / peer, 5.0, unit="times", at_least=True)


def resistance() -> None:
    """Disturbances on all scenes, one at a time."""
    rows = []
    for name in LIMITS:
        scene = textured_scene(name, (SIDE, SIDE), rng=np.random.default_rng(101))
        for size in (64, 128):
            found = disturbed(scene, middle(size))
            rows.append([name, size, *(f"{1e3 * e:.2f} ({1e3 * s:.1f})" for e, s in found.values())])
            worst = max(found, key=lambda key: found[key][0])
            goal(f"{name} {size} px: moved most, by {worst}", found[worst][0], 0.005, unit="px")
    show(["scene, 1e-3 px (reported)", "px", *disturbances(128)], rows)


def memory() -> None:
    """Kernels of a large region."""
    image = np.random.default_rng(5).normal(120, 30, (600, 600)).astype(np.float32)
    tracker = RegistrationTracker(Frame(0, image), Region(40, 40, 512, 512), RegistrationSettings())
    goal("kernels of a region of 512 px", tracker.kernel_bytes / 2**20, 96.0, unit="MB")


def main() -> None:
    rows = []
    for name, (limit, bias) in LIMITS.items():
        scene = textured_scene(name, (SIDE, SIDE), rng=np.random.default_rng(101))
        for size in (64, 128):
            region = middle(size)
            bound = float(np.sqrt(np.mean(np.square(cramer_rao_std_px(scene, CAMERA, region=region)))))
            spread, honest = scatter(scene, region)
            worst = systematic(scene, region)
            rows.append([name, size, bound, *(v / bound for v in spread.values()), honest, worst])
            goal(f"{name} {size} px: scatter over the bound", spread["registration"] / bound, limit)
            goal(f"{name} {size} px: systematic error", worst, bias, unit="px")
            goal(f"{name} {size} px: reported over true deviation", honest, 1.25)
            goal(f"{name} {size} px: reported over true deviation", honest, 0.8, at_least=True)
    show(["scene", "px", "bound px", "ours", "matchTemplate", "scikit-image", "reported/true", "systematic px"], rows)
    resistance()
    memory()
    speeds(scene)
