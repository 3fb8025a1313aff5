"""Registration tracker against its bound and its goals, beside matchTemplate with a parabola and scikit-image."""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.table import goal, show
from midspan.records import Floats, Frame, Prediction, Region
from midspan.simulate.camera import Camera, Pixels, cramer_rao_std_px
from midspan.simulate.scene import Scene
from midspan.simulate.texture import textured_scene
from midspan.vision.kernels import project
from midspan.vision.registration import RegistrationSettings, RegistrationTracker

SIDE, REFERENCES, LEARNT, FRAMES = 200, 6, 25, 40
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
        for k, (x, y) in enumerate(rng.uniform(-0.6, 0.6, (LEARNT + FRAMES, 2))):
            image = CAMERA.expose(scene.render(x, y), rng=rng)
            found = tracker.push(Frame((k + 1) * 10**7, image), NEAR)
            if k < LEARNT:
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
    """Largest error (px) over the phases, without noise."""
    tracker = RegistrationTracker(Frame(0, scene.render(0, 0)), region, RegistrationSettings(learn_frames=0))
    places = np.array([(k / 24 - 0.5, (7 * k % 24) / 24 - 0.5) for k in range(24)])
    found = [tracker.push(Frame((k + 1) * 10**7, scene.render(*p)), NEAR) for k, p in enumerate(places)]
    return float(np.abs(np.array([(f.x_px, f.y_px) for f in found]) - places).max())


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
    rows = []
    for bank in tracker.banks:
        count = len(bank.centres)
        at = (np.full(count, region.y), np.full(count, region.x), np.full(count, 136))
        kernel = rate(lambda bank=bank, at=at: project(image, 0.0, bank.kernels, bank.edges, at), 1000)
        rows.append([f"kernel, {count} blocks", kernel])
        goal(f"kernel with {count} blocks", kernel, 30_000, unit="regions/s", at_least=True)
    ours = rate(lambda: tracker.push(Frame(2, image), NEAR), 300)
    peer = rate(lambda: parabola(reference, image, region), 50)
    rows += [
        ["push", ours],
        ["matchTemplate", peer],
        ["scikit-image", rate(lambda: upsampled(reference, image, region), 20)],
    ]
    show(["128 px, one thread", "regions/s"], rows)
    goal("push against matchTemplate and parabola", ours / peer, 5.0, unit="times", at_least=True)


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
    show(["scene", "px", "bound px", "ours", "matchTemplate", "scikit-image", "reported/true", "systematic px"], rows)
    speeds(scene)
