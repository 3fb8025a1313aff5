"""Knowing when not to trust the picture: true error, reported deviation before and after widening, warnings."""

import io
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from benchmarks.table import goal, show
from midspan import _core
from midspan.records import Floats, Frame, PixelTrack, PixelTranslation, Prediction, Region, Status
from midspan.simulate.scene.camera import Camera, Pixels
from midspan.simulate.scene.scene import Scene
from midspan.simulate.scene.texture import TEXTURES, textured_scene
from midspan.vision.picture_report import picture_report, picture_warnings
from midspan.vision.target import translation_of
from midspan.vision.tracker import open_tracker

# Never used while the constants were set.
SEEDS, CLEAN_SEEDS = range(4100, 4102), range(4200, 4202)
RATE_HZ, COUNT, SIDE = 10, 80, 208
REGION = Region(56, 56, 96, 96)
USUAL, QUIET = Camera(), Camera(full_well_e=40_000.0, read_noise_e=3.0)
CODECS: dict[str, tuple[str, dict[str, str], str]] = {
    **{f"x264 CRF {q}": ("libx264", {"crf": str(q)}, "gray") for q in (10, 14, 18, 23, 28, 33)},
    "x264 CRF 23, ultrafast": ("libx264", {"crf": "23", "preset": "ultrafast"}, "yuv420p"),
    "x264 CRF 20, no B": ("libx264", {"crf": "20", "bf": "0"}, "yuv420p"),
    "x265 CRF 23": ("libx265", {"crf": "23", "x265-params": "log-level=none"}, "yuv420p"),
    "x265 CRF 28": ("libx265", {"crf": "28", "x265-params": "log-level=none"}, "yuv420p"),
    "MPEG-4 q 5": ("mpeg4", {"qmin": "5", "qmax": "5"}, "yuv420p"),
    **{f"MJPEG q {q}": ("mjpeg", {"qmin": str(q), "qmax": str(q)}, "yuvj420p") for q in (2, 5, 10)},
}
LIMITS = (0.5, 2.0)
TRACKER = "template"  # the registration tracker gives nearly the same table


def through(pictures: list[Pixels], codec: str, options: dict[str, str], layout: str) -> list[Pixels]:
    """The pictures after encoding and decoding; luma over its full range."""
    import av

    memory = io.BytesIO()
    with av.open(memory, "w", format="matroska") as container:
        stream = container.add_stream(codec, rate=RATE_HZ, options=options)
        stream.height, stream.width = pictures[0].shape
        stream.pix_fmt = layout
        if "qmin" in options:
            stream.codec_context.qmin, stream.codec_context.qmax = int(options["qmin"]), int(options["qmax"])
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame(picture.shape[1], picture.shape[0], layout)
            for plane, values in zip(frame.planes, (picture, None, None), strict=False):
                padded = np.full((plane.height, plane.line_size), 128, dtype=np.uint8)
                if values is not None:
                    padded[:, : plane.width] = values
                plane.update(padded.tobytes())
            frame.pts, frame.time_base = k, Fraction(1, RATE_HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    memory.seek(0)
    with av.open(memory) as container:
        return [_luma(frame) for frame in container.decode(video=0)]


def _luma(frame) -> Pixels:
    plane = frame.planes[0]
    rows = np.frombuffer(plane, dtype=np.uint8).reshape(plane.height, plane.line_size)
    return np.ascontiguousarray(rows[:, : plane.width])


def motion(name: str, rng: np.random.Generator) -> Floats:
    """Translations (frames, 2) in px from 0 on: a sine of this many px along y, or four of them."""
    t = np.arange(COUNT) / RATE_HZ
    if name == "broad":
        y = sum(rng.uniform(0.1, 0.6) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.3, 0.7, 1.3, 2.1))
        x = 0.3 * np.sin(2 * np.pi * 0.5 * t)
    else:
        y, x = float(name) * np.sin(2 * np.pi * 0.7 * t), 0.3 * float(name) * np.sin(2 * np.pi * 0.43 * t)
    out = np.column_stack((x, y))
    return out - out[0]


def film(
    scene: Scene, path: Floats, camera: Camera, rng: np.random.Generator, change: Callable | None = None
) -> list[Pixels]:
    """Pictures of the scene along `path`; `change` makes other ones from frame 20 on."""
    out = []
    for k, (x, y) in enumerate(path):
        mean = scene.render(float(x), float(y)) if change is None or k < 20 else change(float(x), float(y))
        out.append(camera.expose(mean.astype(np.float32), rng=rng))
    return out


@dataclass(frozen=True)
class Run:
    """One run: error and reported deviation (px) before and after, the warnings."""

    error: float
    before: float
    after: float
    warnings: list[str]


def opened(frame: Frame, region: Region) -> _core.TargetChain:
    """What looks at the pictures of a target."""
    place = region.x, region.y, region.width, region.height
    return _core.TargetChain(frame.pixels, place, picture=True, light=False, lossless=False)


def run(pictures: list[Pixels], path: Floats, name: str, region: Region = REGION, first: int = 1) -> Run:
    """Track with an accelerometer's prediction and watch; both axes, frames from `first` on."""
    frames = [Frame(round(1e9 * k / RATE_HZ), picture, k) for k, picture in enumerate(pictures)]
    tracker, watch, rows, wider = open_tracker(name, frames[0], region), opened(frames[0], region), [], []
    for frame, (x, y) in zip(frames, path, strict=True):
        rows.append(tracker.push(frame, Prediction(float(x), float(y), 0.3, 0.3)))
        wider.append(translation_of(watch.push(frame.pixels, frame.time_ns, rows[-1])))
    track, wide, report = PixelTrack.stack(rows), PixelTrack.stack(wider), picture_report(watch)
    assert report is not None
    errors = np.column_stack((track.x_px, track.y_px))[first:] - path[first:]

    def usual(of: PixelTrack) -> float:
        return float(np.sqrt(np.nanmedian(np.concatenate((of.variance_x_px2[first:], of.variance_y_px2[first:])))))

    return Run(float(np.sqrt(np.nanmean(errors**2))), usual(track), usual(wide), picture_warnings(report, "y"))


def clean() -> None:
    """Raw frames: nothing may be widened, nothing reported."""
    worst, reported, count = 1.0, 0, 0
    for camera in (USUAL, QUIET):
        for texture in TEXTURES:
            for seed in CLEAN_SEEDS:
                rng = np.random.default_rng(seed)
                scene = textured_scene(texture, (SIDE, SIDE), rng=rng)
                for name in ("0.02", "0.5", "broad", "3"):
                    path = motion(name, rng)
                    pictures = film(scene, path, camera, rng)
                    for size in (64, 128):
                        region = Region((SIDE - size) // 2, (SIDE - size) // 2, size, size)
                        found = run(pictures, path, "template", region)
                        worst = max(worst, found.after / found.before)
                        reported, count = reported + bool(found.warnings), count + 1
    goal(f"raw frames: largest factor of the standard deviation in {count} runs", worst, 1.02)
    goal("raw frames: runs with a warning", reported, 0)


def compression(tracker: str) -> None:
    """Through codecs: natural, block and facade textures, motions of 0.1 px to 3 px."""
    found: dict[str, list[Run]] = {name: [] for name in ("raw", *CODECS)}
    for camera, seed in zip((USUAL, QUIET), SEEDS, strict=True):
        for texture in ("natural", "blocks", "facade"):
            rng = np.random.default_rng(seed)
            scene = textured_scene(texture, (SIDE, SIDE), rng=rng)
            for name in ("0.1", "0.5", "broad", "3"):
                path = motion(name, rng)
                pictures = film(scene, path, camera, rng)
                found["raw"].append(run(pictures, path, tracker))
                for codec, how in CODECS.items():
                    found[codec].append(run(through(pictures, *how), path, tracker))
    rows, within = [], []
    for codec, runs in found.items():
        before, after = (np.array([value(r) / r.error for r in runs]) for value in (_before, _after))
        rows.append(
            [
                codec,
                float(np.median([r.error for r in runs])),
                _geometric(before),
                _geometric(after),
                f"{after.min():.2f} ... {after.max():.2f}",
                f"{sum(bool(r.warnings) for r in runs)} of {len(runs)}",
            ]
        )
        if codec != "raw":
            within += after.tolist()
    print()
    show(["codec", "error px", "reported/true before", "after", "range", "warned"], rows)
    share = float(np.mean([LIMITS[0] <= value <= LIMITS[1] for value in within]))
    goal("codecs: share of runs with reported/true from 0.5 to 2", share, 0.8, at_least=True)
    goal("codecs: farthest mean from 1 (factor)", max(float(np.exp(abs(np.log(row[3])))) for row in rows), 2.0)


def _before(found: Run) -> float:
    return found.before


def _after(found: Run) -> float:
    return found.after


def _geometric(values: Floats) -> float:
    return float(np.exp(np.mean(np.log(values))))


def disturbances(tracker: str) -> None:
    """Blur, focus, saturation and darkness from frame 20 on; a weak texture from the first."""
    rows = []
    for what in ("nothing", "focus 1.2 px", "motion blur 4 px", "saturated", "saturated from the start", "weak, 40 px"):
        runs = [_disturbed(what, texture, tracker) for texture in ("natural", "blocks", "facade")]
        before, after = (np.array([value(r) / r.error for r in runs]) for value in (_before, _after))
        reported = f"{sum(bool(r.warnings) for r in runs)} of 3"
        rows.append([what, max(r.error for r in runs), float(before.min()), float(after.min()), reported])
    print()
    show(["disturbance", "largest error px", "least reported/true before", "after", "warned"], rows)


def _disturbed(what: str, texture: str, tracker: str) -> Run:
    rng = np.random.default_rng(4300)
    texture = "weak" if what.startswith("weak") else texture
    scene = textured_scene(texture, (SIDE, SIDE), rng=np.random.default_rng(4301))
    soft = textured_scene(texture, (SIDE, SIDE), rng=np.random.default_rng(4301), lens_px=float(np.hypot(0.6, 1.2)))
    over = (np.arange(15) + 0.5) / 15 - 0.5
    changes: dict[str, Callable] = {
        "focus 1.2 px": soft.render,
        "motion blur 4 px": lambda x, y: scene.render(np.full(15, x), y + 4.0 * over),
        "saturated": lambda x, y: 1.6 * scene.render(x, y),
    }
    path, camera = motion("0.5", rng), USUAL
    if what.endswith("start"):
        pictures = [
            camera.expose((1.6 * scene.render(float(x), float(y))).astype(np.float32), rng=rng) for x, y in path
        ]
    else:
        pictures = film(scene, path, camera, rng, changes.get(what))
    region = Region(84, 84, 40, 40) if what.startswith("weak") else REGION
    return run(pictures, path, tracker, region, first=20)


def cost() -> None:
    """Time of a look against that of a tracker."""
    rng = np.random.default_rng(0)
    scene = textured_scene("natural", (SIDE, SIDE), rng=rng)
    frames = [Frame(10_000_000 * k, USUAL.expose(scene.render(0.0, 0.3 * np.sin(k)), rng=rng)) for k in range(50)]
    rows = []
    for size in (64, 128):
        region = Region((SIDE - size) // 2, (SIDE - size) // 2, size, size)
        watch = opened(frames[0], region)
        spent = {name: _microseconds(open_tracker(name, frames[0], region).push, frames) for name in _TRACKERS}

        def look(frame: Frame, watch: _core.TargetChain = watch) -> None:
            y = 0.3 * float(np.sin(frame.time_ns / 1e7))
            found = PixelTranslation(frame.time_ns, 0.0, y, 1e-6, 1e-6, 1.0, Status.TRACKING)
            watch.push(frame.pixels, frame.time_ns, found)

        mine = _microseconds(look, frames, repeats=8)
        rows.append([size, mine, *(100.0 * mine / spent[name] for name in _TRACKERS)])
    show(["side px", "a look us", *(f"% of {name}" for name in _TRACKERS)], rows)
    goal("cost: mean share of the trackers' time at 128 px", float(np.mean(rows[-1][2:])), 10.0, unit="%")


_TRACKERS = ("template", "registration", "phase", "features")


def _microseconds(work: Callable[[Frame], object], frames: list[Frame], repeats: int = 1) -> float:
    for frame in frames:
        work(frame)
    start = time.perf_counter()
    for _ in range(repeats):
        for frame in frames:
            work(frame)
    return 1e6 * (time.perf_counter() - start) / (repeats * len(frames))


def main() -> None:
    clean()
    compression(TRACKER)
    disturbances(TRACKER)
    cost()
