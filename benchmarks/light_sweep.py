"""A wall in relief under a light that swings by 60° either way: key frames against the fixed first frame, by wall."""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.table import goal, show
from midspan.records import Event, Floats, Frame
from midspan.vision.reference_frames import KeyFrameSettings, KeyFrameTracker
from midspan.vision.tracker import Tracker, open_tracker

FRAMES = 600  # 120 s at five frames a second
SHOWN = range(5)
HELD_OUT = tuple(range(30, 38))  # no constant was chosen on these, nor on the sky's walls


def scenes() -> Any:
    """The scenes of the tests."""
    folder = str(Path(__file__).parents[1] / "tests" / "vision")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    import reference_scenes

    return reference_scenes


def sweep(seed: int, *, back: bool = False, **sky: Any) -> tuple[list[Frame], Floats]:
    """Frames and truth (n, 2) of wall `seed`: light from -60° to 60°, and `back`, at 0.35 of its strength between."""
    made = scenes()
    turn = np.arange(FRAMES) / FRAMES
    angles = -60.0 * np.cos((2.0 if back else 1.0) * np.pi * turn)
    frames, truth = made.swept(seed, angles, 1.0 - 0.65 * np.sin(np.pi * turn) ** 4, sky=made.Sky(**sky))
    return frames, np.asarray(truth)


def follow(tracker: Tracker, frames: list[Frame]) -> tuple[Floats, Floats]:
    """Translations and standard deviations (n, 2) in px."""
    xy, std = scenes().track(tracker, frames)
    return xy, std


def cost(inner: str) -> float:
    """Processor time a frame of key frames in a sweep, over that of the tracker inside while it lasts."""
    frames, _ = sweep(0)
    region = scenes().REGION
    alone = open_tracker(inner, frames[0], region)
    keys = KeyFrameTracker(frames[0], region, KeyFrameSettings(tracker=inner))
    return _spent(keys, frames) / _spent(alone, frames[: FRAMES // 3])


def _spent(tracker: Tracker, frames: list[Frame]) -> float:
    """Processor time a frame in s, without the first twenty frames."""
    follow(tracker, frames[:20])
    start = time.process_time()
    follow(tracker, frames[20:])
    return (time.process_time() - start) / (len(frames) - 20)


def steps(events: list[Event], error: Floats) -> Floats:
    """Error steps (changes, 2) in px: means of three frames before and after each change of key frame."""
    rate = scenes().RATE_HZ
    places = [round(event.time_ns / 1e9 * rate) for event in events]
    inside = [k for k in places if 2 <= k < len(error) - 3]
    return np.array([error[k + 1 : k + 4].mean(axis=0) - error[k - 2 : k + 1].mean(axis=0) for k in inside])


def one(seed: int, **sky: Any) -> dict[str, float]:
    """What one wall gives."""
    frames, truth = sweep(seed, **sky)
    region = scenes().REGION
    lost = np.isnan(follow(open_tracker("template", frames[0], region), frames)[0][:, 0]).mean()
    tracker = KeyFrameTracker(frames[0], region)
    xy, std = follow(tracker, frames)
    error = xy - truth
    jumps = steps(tracker.take_events(), error)
    return {
        "fixed lost %": 100.0 * lost,
        "missing": float(np.isnan(xy[:, 0]).sum()),
        "rms px": float(np.sqrt(np.mean(error**2))),
        "largest px": float(np.abs(error).max()),
        "end px": float(np.abs(error[-5:].mean(axis=0)).max()),
        "step px": float(np.sqrt(np.mean(jumps**2))) if len(jumps) else 0.0,
        "key frames": float(tracker.key_frames),
        "in 1.96 σ %": 100.0 * float(np.mean(np.abs(error) < 1.96 * std)),
    }


def table(title: str, walls: tuple[int, ...], **sky: Any) -> list[dict[str, float]]:
    """Print one row a wall; returns the rows."""
    rows = [one(seed, **sky) for seed in walls]
    print(f"\n{title}")
    show(["wall", *rows[0]], [[seed, *row.values()] for seed, row in zip(walls, rows, strict=True)])
    return rows


def worst(rows: list[dict[str, float]], what: str) -> float:
    return max(row[what] for row in rows)


def main() -> None:
    there = table("Walls of the documentation, there", tuple(SHOWN)) + table("Held-out walls, there", HELD_OUT)
    back = table("There and back", (*SHOWN, *HELD_OUT[:4]), back=True)
    aside = table(
        "Sky light 20 %, the light swings across as well", tuple(range(40, 44)), aside=(-0.8, 0.8), ambient=0.2
    )
    table("Sky light 20 %, bumps throw shadows (no goal)", tuple(range(40, 44)), ambient=0.2, cast=True)
    rows = there + back + aside
    goal("rms, worst wall", worst(rows, "rms px"), 0.08, unit="px")
    goal("key frames in 120 s, worst wall", worst(rows, "key frames"), 15)
    goal("missing estimates", worst(rows, "missing"), 0)
    goal("lost by a fixed reference, least", min(row["fixed lost %"] for row in there), 40, unit="%", at_least=True)
    goal("error step at a change, rms, worst wall", worst(rows, "step px"), 0.02, unit="px")
    goal("error after the return, worst wall", worst(back, "end px"), 0.05, unit="px")
    goal("inside 1.96 standard deviations, least", min(r["in 1.96 σ %"] for r in rows), 93, unit="%", at_least=True)
    for inner in ("template", "hybrid", "registration"):
        goal(f"time against the tracker inside, {inner}", cost(inner), 3.0)
