"""The course of a point's first natural frequencies: one segment of rows a step of time, each computed once.

A stiffness that falls by two per cent lowers a natural frequency by one: over weeks this is what a structure's
condition is read from, together with temperature, which moves it as far.
"""

import math
import time

import numpy as np
from fastapi import APIRouter
from pydantic import BaseModel, Field

from midspan.evaluate.spectrum import OTHER_SHARE
from midspan.records import NANOSECONDS
from midspan.serve import reading
from midspan.serve.instants import From, To, span_ns
from midspan.serve.login import READ
from midspan.serve.points import OF_A_POINT, Numbers
from midspan.serve.problems import Problem
from midspan.serve.serving import Serving, Shared
from midspan.service.live_socket import Tree

# Twenty minutes have 2500 periods of 2 Hz, by which it is known to 0.1 %; a spectrum of them takes a third of a second.
SEGMENT_S = 1200
# Steps that a course may have, s, and how many of them: the shortest step is taken that these are enough of.
STEPS_S = (1800, 3600, 10_800, 21_600, 43_200, 86_400, 172_800, 604_800, 2_592_000)
MAX_STEPS = 60
# What one call computes at most, s; the rest is for the next one, so that spectra and rows of others come in between.
BUDGET_S = 5.0
# Segments that are kept in memory: of 150 courses; each is some hundred bytes.
MAX_KEPT = 150 * MAX_STEPS
# A frequency that fewer of the segments have is no mode to follow: half. The lowest ones are followed.
MIN_SHARE, MODES = 0.5, 3
USUAL_S = 7 * 86_400.0

Segment = tuple[int, list[Tree]] | None


class ModeCourse(BaseModel):
    """A natural frequency in each segment, null where it does not stand out there."""

    frequency_hz: Numbers
    frequency_std_hz: Numbers
    rms_mm: Numbers = Field(description="of the displacement in it")


class FrequenciesBody(BaseModel):
    """The first natural frequencies of one segment a step; complete: false where asking again gives more."""

    step_s: float
    segment_s: float
    time: list[int] = Field(description="the begin of each segment, ns UTC")
    modes: list[ModeCourse]
    complete: bool
    reason: str = Field(description="reason why there are no modes, else empty")


routes = APIRouter(prefix="/points", tags=["points"])


@routes.get("/{name}/frequencies", response_model=FrequenciesBody, dependencies=READ, responses=OF_A_POINT)
async def frequencies(name: str, serving: Shared, begin: From = None, to: To = None) -> Tree:
    """The course of the first natural frequencies over a time (left out: a week), in at most 60 steps."""
    await serving.require_point(name)
    first_ns, end_ns = span_ns(begin, to, USUAL_S)
    step_s = step_of((end_ns - first_ns) / NANOSECONDS)
    step_ns = step_s * NANOSECONDS
    steps = range(first_ns // step_ns, -(-end_ns // step_ns))
    async with serving.following:
        segments = await segments_of(serving, name, step_ns, steps)
    return {"step_s": step_s, "segment_s": SEGMENT_S, "complete": len(segments) == len(steps), **course(segments)}


def step_of(length_s: float) -> int:
    """The step of a course of a length, s. Raises Problem where it has too many."""
    for step_s in STEPS_S:
        # One more, as steps begin at whole multiples.
        if length_s <= step_s * (MAX_STEPS - 1):
            return step_s
    raise Problem(422, f"from, to: must span at most {STEPS_S[-1] * (MAX_STEPS - 1) // 86_400} days.")


async def segments_of(serving: Serving, name: str, step_ns: int, steps: range) -> list[Segment]:
    """The segments of the first steps: those that are kept, and of the others at least one."""
    found, until_s = list[Segment](), math.inf
    for step in steps:
        if (key := (name, step_ns, step)) in serving.segments:
            found.append(serving.segments[key])
            continue
        if time.monotonic() > until_s:
            break
        until_s = min(until_s, time.monotonic() + BUDGET_S)
        found.append(await segment(serving, *key))
    return found


async def segment(serving: Serving, name: str, step_ns: int, step: int) -> Segment:
    """The segment of a step, which is kept where no row of it can come any more: rows after it are stored, and those of
    a point are stored in their order, however long the store was away.
    """
    span = (step * step_ns, (step + 1) * step_ns)
    newest_ns = await serving.quick.run(reading.newest_ns, serving.where, name)
    found = await serving.long.run(
        reading.segment_modes, serving.where, name, *span, SEGMENT_S * NANOSECONDS
    )  # fmt: skip
    if newest_ns is not None and newest_ns >= span[1]:
        serving.segments[name, step_ns, step] = found
        while len(serving.segments) > MAX_KEPT:
            del serving.segments[next(iter(serving.segments))]
    return found


def course(segments: list[Segment]) -> Tree:
    """The modes that half of the segments have, the lowest three, by frequency."""
    kept = [one for one in segments if one is not None]
    times = [begin_ns for begin_ns, _ in kept]
    if not kept:
        text = f"The time range has no uninterrupted rows of {SEGMENT_S // 120} minutes or more."
        return {"time": [], "modes": [], "reason": text}
    groups = [one for one in grouped([modes for _, modes in kept]) if len(one) >= MIN_SHARE * len(kept)]
    keys = ("frequency_hz", "frequency_std_hz", "rms_mm")
    modes = [
        {key: [group[k][key] if k in group else None for k in range(len(kept))] for key in keys}
        for group in groups[:MODES]
    ]
    return {
        "time": times,
        "modes": modes,
        "reason": "" if modes else "No frequency is significant in half of the segments.",
    }


def grouped(segments: list[list[Tree]]) -> list[dict[int, Tree]]:
    """Modes of segments that are the same mode: frequencies without a gap of a tenth; of two of a segment the stronger.

    Each group holds modes by the number of their segment; groups are in the order of frequency.
    """
    every = sorted(
        ((one["frequency_hz"], k, one) for k, modes in enumerate(segments) for one in modes), key=lambda x: x[0]
    )
    groups, last_hz = list[dict[int, Tree]](), -np.inf
    for frequency_hz, k, mode in every:
        if frequency_hz > (1.0 + OTHER_SHARE) * last_hz or not groups:
            groups.append({})
        last_hz = frequency_hz
        if k not in groups[-1] or groups[-1][k]["rms_mm"] < mode["rms_mm"]:
            groups[-1][k] = mode
    return groups
