"""Targets that differ by more than white noise: one of them moves on its own, or the camera tilts.

What two targets differ by beyond noise (`difference`) is in one of them, or in both as a tilt makes it, in proportion
to their distances. Each of these puts another share of it into the translation of the better target: none of it, all,
or D / (D - D'). The accelerometer tells that share, as far as it feels what is so fast (`share_in`). What it leaves
open is held by the error band, or refused where it is too much of the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from math import degrees

import numpy as np

from midspan.calibration.camera.difference import MIN_FRAMES, Course, Difference, Share, difference, share_in
from midspan.calibration.camera.view import SeenTarget, View, camera_blocks, filter_settings, target_block
from midspan.calibration.common_offset import Fitted
from midspan.calibration.frequency_shapes import VERTICAL_M_S2
from midspan.calibration.scale import REFUSED_ABOVE
from midspan.calibration.sensors.camera import CameraCalibration, CameraScale, TargetCalibration
from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import smooth
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Displacement, part

# Scale factors nearer to each other than this share belong to targets at one distance.
SAME_DISTANCE = 0.1
# A target that differs from another by this many times the white noise of one frame is left out where it is the cause.
DISAGREES = 2.5
# Less than this is of no weight: no tracker is right to the last digit.
MIN_APART_M = 1e-5
# A target this many times as far as another one hardly moves in the picture: it may as well be fixed to the camera.
MAX_RATIO = 30.0
# A camera on a level axis that looks up at a target in the distance D swings unfelt and unseen at √(g / D) / 2π: from 2
# to 100 m in this range, Hz; elsewhere the accelerometer shows what the target does not.
PENDULUM_HZ = (0.05, 0.35)
# A swing is within this share of its frequency, with this share of its power.
NARROW, NARROW_SHARE = 0.15, 0.8


def tilt_text(kept: tuple[str, float], other: tuple[str, float], error_m: float, *, decided: bool = False) -> str:
    """What a tilt makes of two targets, by their names and scale factors (m/px), and what to do about it.

    error_m: what it makes of the displacement of the one that is kept, rms. With displacements d + θ D of targets at
    the distances D that is D / |D - D'| of what they are apart. decided: whether the accelerometer excludes all other
    causes.
    """
    per = error_m / abs(kept[1])
    (near, near_m), (far, far_m) = sorted(
        ((name, per * abs(scale)) for name, scale in (kept, other)), key=lambda named: named[1]
    )
    makes = (
        f"which causes displacement errors of {1e3 * near_m:.2g} mm rms at {near} and {1e3 * far_m:.2g} mm rms at {far}"
    )
    use = (
        f"use {near} alone, with camera.distance_m and camera.tilt_std_mdeg = {1e3 * degrees(near_m):.2g} / distance "
        "in m, which adds the tilt to the band"
    )
    ratio = f"Their distance ratio is {far_m / near_m:.2g}: "
    if decided:
        return (
            f"{ratio}the camera tilts, {makes}; the accelerometer excludes motion of one target alone. Mount the "
            f"camera more stiffly, measure its tilt, or {use}."
        )
    return (
        f"{ratio}either the camera tilts, {makes}, or one target moves on its own. For a tilt: {use}. For a moving "
        "target: remove it from camera.target, or add a third target."
    )


class Cause(Enum):
    """Why two targets differ: the other one moves on its own, this one does, or the camera tilts."""

    OTHER = "other"
    THIS = "this"
    TILT = "tilt"


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """A target that is compared: its place among all, scale (m/px, signed), that one's relative standard deviation,
    and its displacement.
    """

    place: int
    name: str
    scale_m_per_px: float
    relative_std: float
    block: Displacement

    @property
    def noise_m2(self) -> float:
        """Usual variance of a frame; infinite for a target that was never seen."""
        known = self.block.variance_m2[np.isfinite(self.block.variance_m2)]
        return float(np.median(known)) if len(known) else np.inf


@dataclass(frozen=True, slots=True)
class Verdict:
    """A pair's causes that the accelerometer leaves open; size_m: rms of the difference beyond noise; error_m: the most
    that this may make of the displacement of the one that is kept, in a row and in the zero.
    """

    kept: Member
    other: Member
    open: frozenset[Cause]
    size_m: float
    error_m: float
    other_m: float = 0.0

    @property
    def either_m(self) -> float:
        """The most that it may make of a displacement that rests on either of both, as where one alone is accepted."""
        return max(self.error_m, self.other_m)


def m_per_px(target: TargetCalibration) -> float:
    """Size of a target's scale factor, in proportion to its distance; NaN where it was refused."""
    return np.nan if target.scale is None else abs(target.scale.value_m_per_px)


def agreed(
    view: View, targets: Sequence[SeenTarget], camera: CameraCalibration, fit: Fitted
) -> tuple[CameraCalibration, tuple[Notice, ...]]:
    """The calibration along one axis without the targets that move on their own, with what the others differ by, and
    sentences on it.

    Raises UntrustedError where the accelerometer does not tell which target is right and too much depends on it.
    """
    if len(targets) < 2:
        return camera, ()
    held: dict[frozenset[int], Verdict] = {}
    while len(camera.used) > 1:
        compared = _Compared(view, targets, camera, fit)
        verdict = compared.worst(held)
        if verdict is None:
            break
        if verdict.open in (frozenset({Cause.OTHER}), frozenset({Cause.THIS})):
            mover, fixed = verdict.other, verdict.kept
            if Cause.THIS in verdict.open:
                mover, fixed = fixed, mover
            reason = (
                f"it moves on its own: it differs from {fixed.name} by {1e3 * verdict.size_m:.2g} mm rms, more than "
                "its noise and scale factor explain."
            )
            left = list(camera.targets)
            left[mover.place] = replace(left[mover.place], used=False, reason=reason)
            camera = replace(camera, targets=tuple(left))
            held = {places: one for places, one in held.items() if mover.place not in places}
        else:
            held[frozenset((verdict.kept.place, verdict.other.place))] = compared.accepted(verdict)
    last = _Compared(view, targets, camera, fit)
    judged = [last.accepted(one) for one in last.refused()]
    small = last.slight(held)
    shared_m = last.shared()
    error_m = max((shared_m, *(one.error_m for one in (*judged, *small)), *(one.either_m for one in held.values())))
    texts = [
        f"Targets {one.kept.name} and {one.other.name} differ by {1e3 * one.size_m:.2g} mm rms, more than their noise "
        f"and scale factors explain; the error band includes {1e3 * one.either_m:.2g} mm for it. {_cause_text(one)}"
        for one in (*held.values(), *judged)
    ]
    if shared_m > 0.0:
        texts.append(f"{_shared_text(shared_m)} The error band includes it.")
    camera = replace(camera, apart_std_m=float(np.hypot(camera.apart_std_m, error_m)))
    return camera, tuple(Notice("motion-not-shared", text) for text in texts)


def certainly_tilts(view: View, targets: Sequence[SeenTarget], camera: CameraCalibration, fit: Fitted) -> bool:
    """Whether the accelerometer excludes all causes of what the targets along one axis differ by but a tilt."""
    verdict = _Compared(view, targets, camera, fit).worst({}) if len(camera.used) > 1 else None
    return verdict is not None and verdict.open == frozenset({Cause.TILT})


class _Compared:
    """The targets along one axis as displacements, compared in the calibration window."""

    def __init__(self, view: View, targets: Sequence[SeenTarget], camera: CameraCalibration, fit: Fitted) -> None:
        self._view, self._targets, self._camera, self._fit = view, targets, camera, fit
        used = [k for k, target in enumerate(camera.targets) if target.used]
        best = fit.found[min(used, key=lambda k: m_per_px(camera.targets[k]) * camera.targets[k].noise_std_px)]
        assert best is not None
        noise = best.input_noise
        acceleration = view.prepared.with_noise(noise.density, noise.motion_s)
        blocks = camera_blocks([targets[k] for k in used], camera, acceleration)
        # Frames of a minute need no day of it.
        first = min(int(block.time_ns[0]) for block in blocks) - NANOSECONDS
        last = max(int(block.time_ns[-1]) for block in blocks) + NANOSECONDS
        first, last = (int(i) for i in np.searchsorted(acceleration.time_ns, (first, last)))
        self._acceleration = part(acceleration, slice(first, last))
        self.members = [
            Member(k, targets[k].name, mapping.scale_m_per_px, mapping.relative_std, block)
            for k, mapping, block in zip(used, camera.mappings(), blocks, strict=True)
        ]
        self._sharpest = min(self.members, key=lambda member: member.noise_m2)
        kalman = filter_settings(view.prepared, noise.density, lean=best.search.pair.lean)
        self._path = smooth(self._acceleration, self._sharpest.block, kalman).estimate
        first, last = (int(i) for i in np.searchsorted(blocks[0].time_ns, view.window_ns))
        self._window = slice(first, last) if last - first >= MIN_FRAMES else slice(0, len(blocks[0].time_ns))
        self._motion = at(self._path, blocks[0].time_ns)[0][self._window]
        self._found: dict[tuple[int, int], Difference] = {}

    def worst(self, held: dict[frozenset[int], Verdict]) -> Verdict | None:
        """What is to be decided first: the target that agrees with the fewest, compared with the best of the rest."""
        members = self.members
        count = len(members)
        apart = np.zeros((count, count))
        for i in range(count):
            for k in range(i):
                found = self._between(members[i], members[k])
                limit = max(DISAGREES * found.noise_m, MIN_APART_M) if found.excess_m > 0.0 else np.inf
                if frozenset((members[i].place, members[k].place)) not in held and found.excess_m > limit:
                    apart[i, k] = apart[k, i] = found.excess_m / limit
        moved = apart > 0.0
        if not moved.any():
            return None
        agreeing = np.sum(~moved, axis=0)
        leading = agreeing[moved.any(axis=0)].max()
        best = min(
            (k for k in range(count) if moved[k].any() and agreeing[k] == leading), key=lambda k: members[k].noise_m2
        )
        others = np.flatnonzero(moved[best])
        fewest = others[agreeing[others] == agreeing[others].min()]
        worst = int(fewest[np.argmax(apart[best, fewest])])
        # Those that agree with the best one, where they are a majority against the worst one.
        group = [member for k, member in enumerate(members) if k != best and not moved[best, k]]
        majority = np.sum(~moved[best]) > np.sum(~moved[worst])
        return self._verdict(members[best], members[worst], group if majority else [])

    def refused(self) -> list[Verdict]:
        """Targets without a scale factor, compared with the best one, where that one may be wrong as well."""
        verdicts = []
        for k, target in enumerate(self._camera.targets):
            if target.used or self._fit.found[k] is not None:
                continue
            member = self._without_scale(k)
            if member is None:
                continue
            if self._between(self._sharpest, member).excess_m > 0.0:
                verdict = self._verdict(self._sharpest, member, [])
                if verdict.open != frozenset({Cause.OTHER}):
                    verdicts.append(verdict)
        return verdicts

    def slight(self, held: dict[frozenset[int], Verdict]) -> list[Verdict]:
        """The best target's differences that are too small to leave any target out."""
        small = []
        for member in self.members:
            pair = frozenset((member.place, self._sharpest.place))
            if member is self._sharpest or pair in held:
                continue
            if self._between(self._sharpest, member).excess_m > 0.0:
                verdict = self._verdict(self._sharpest, member, [])
                # What the other one errs by is in their mean by its weight.
                weight = self._sharpest.noise_m2 / (self._sharpest.noise_m2 + member.noise_m2)
                small.append(replace(verdict, error_m=max(verdict.error_m, weight * verdict.size_m)))
        return small

    def shared(self) -> float:
        """Rms (m) of what moves all targets alike from frame to frame, and is no motion of the structure; 0 for none.

        What each differs from the accelerometer by as if it were noise would be in the targets' difference if it were.
        """
        least = np.inf
        for k, one in enumerate(self.members):
            for other in self.members[:k]:
                between = self._between(one, other).noise_m
                alone = [
                    abs(member.scale_m_per_px) * self._camera.targets[member.place].noise_std_px
                    for member in (one, other)
                ]
                common = float(np.sqrt(max(0.5 * (alone[0] ** 2 + alone[1] ** 2 - between**2), 0.0)))
                least = min(least, common if common > DISAGREES * between else 0.0)
        if not np.isfinite(least):
            return 0.0
        moved_m = float(np.std(self._motion))
        if least > REFUSED_ABOVE * moved_m:
            raise UntrustedError(
                f"{_shared_text(least)} At most {100 * REFUSED_ABOVE:g} % of the motion's {1e3 * moved_m:.2g} mm rms "
                "is accepted. Mount the camera more stiffly and add a camera.target at another distance, which shows "
                "a tilt; check the frames' time stamps."
            )
        return least

    def accepted(self, verdict: Verdict) -> Verdict:
        """A verdict that the band can hold; UntrustedError where it is too much of the motion."""
        if verdict.error_m <= REFUSED_ABOVE * float(np.std(self._motion)):
            return verdict
        kept, other = verdict.kept, verdict.other
        text = _cause_text(verdict)
        raise UntrustedError(
            f"Targets {kept.name} and {other.name} contradict each other along {self._view.axis}: they differ by "
            f"{1e3 * verdict.size_m:.2g} mm rms, more than noise and scale factor explain. The displacement may be "
            f"wrong by {1e3 * verdict.error_m:.2g} mm rms; at most {100 * REFUSED_ABOVE:g} % of the motion's "
            f"{1e3 * float(np.std(self._motion)):.2g} mm rms is accepted. {text}"
        )

    def _between(self, one: Member, other: Member) -> Difference:
        if (one.place, other.place) not in self._found:
            w = self._window
            # Rows of a rolling shutter are exposed one after the other.
            expected = [at(self._path, member.block.time_ns[w])[0] for member in (one, other)]
            value = (one.block.value_m[w] - expected[0]) - (other.block.value_m[w] - expected[1])
            variance = one.block.variance_m2[w] + other.block.variance_m2[w]
            scale_std = float(np.hypot(one.relative_std, other.relative_std))
            self._found[one.place, other.place] = difference(value, variance, expected[0], scale_std)
        return self._found[one.place, other.place]

    def _without_scale(self, place: int) -> Member | None:
        """A target without a scale factor of its own, with the one by which it is most like the others."""
        target = self._targets[place]
        pixels, variance = target.rows.along(self._view.axis)
        time_ns = target.rows.time_ns + round(NANOSECONDS * self._camera.offset.value_s)
        moved = at(self._path, time_ns)[0]
        inside = np.zeros(len(pixels), dtype=bool)
        inside[self._window] = True
        inside &= np.isfinite(pixels) & np.isfinite(variance)
        if not inside.any():
            return None
        moved, pixels = moved[inside] - np.mean(moved[inside]), pixels[inside] - np.mean(pixels[inside])
        ratio = float(np.sum(moved * pixels)) / max(float(np.sum(moved**2)), 1e-300)
        # What does not move with the structure tells nothing of the camera.
        if not MAX_RATIO * self._sharpest.scale_m_per_px * ratio > 1.0:
            return None
        mapping = CameraScale(1.0 / ratio, self._view.axis, round(NANOSECONDS * self._camera.offset.value_s))
        block = target_block(target, mapping, self._camera.exposure_s, self._acceleration)
        return Member(place, target.name, 1.0 / ratio, np.inf, block)

    def _verdict(self, kept: Member, other: Member, agreeing: Sequence[Member]) -> Verdict:
        found = self._between(kept, other)
        shares = _shares(kept, other)
        if agreeing:
            # Several that move alike are fixed; at several distances they exclude a tilt as well.
            del shares[Cause.THIS]
            if not all(_alike(one, kept) for one in agreeing):
                shares.pop(Cause.TILT, None)
        measured = self._share(kept, other, found)
        left = frozenset(cause for cause, share in shares.items() if measured.allows(share))
        # Where no single cause explains it there are several.
        left = left or frozenset(shares)
        if Cause.TILT in shares and self._may_be_felt(found):
            left |= {Cause.TILT}
        most = max(abs(shares[cause]) for cause in left)
        others = max(abs(1.0 - shares[cause]) for cause in left)
        return Verdict(kept, other, left, found.excess_m, most * found.held_m, others * found.held_m)

    def _may_be_felt(self, found: Difference) -> bool:
        """Whether gravity may hide a tilt in the acceleration: that of a slow swing, on an axis that is level."""
        if abs(self._view.prepared.level(self._view.window)) > VERTICAL_M_S2:
            return False
        step_s = float(np.median(np.diff(self.members[0].block.time_ns[self._window]))) / NANOSECONDS
        power = np.abs(np.fft.rfft(found.course_m - np.mean(found.course_m))) ** 2
        hertz = np.fft.rfftfreq(len(found.course_m), step_s)
        highest = float(hertz[np.argmax(power)])
        near = np.abs(hertz - highest) < NARROW * highest
        return PENDULUM_HZ[0] < highest < PENDULUM_HZ[1] and bool(np.sum(power[near]) > NARROW_SHARE * np.sum(power))

    def _share(self, kept: Member, other: Member, found: Difference) -> Share:
        own = self._fit.found[kept.place]
        assert own is not None
        offset_s = own.search.fit.offset_s
        time_s = (kept.block.time_ns[self._window] - self._view.window_ns[0]) / NANOSECONDS - offset_s
        noise_px = found.noise_m / abs(kept.scale_m_per_px)
        part_of_noise = kept.noise_m2 / (kept.noise_m2 + other.noise_m2)
        course = Course(time_s, found.course_m / kept.scale_m_per_px, found.shaped, noise_px, part_of_noise)
        return share_in(own.search.pair, own.search.fit, course)


def _shares(kept: Member, other: Member) -> dict[Cause, float]:
    """The share of the difference that each cause puts into the displacement of the target that is kept."""
    shares = {Cause.OTHER: 0.0, Cause.THIS: 1.0}
    if not _alike(kept, other):
        shares[Cause.TILT] = kept.scale_m_per_px / (kept.scale_m_per_px - other.scale_m_per_px)
    return shares


def _alike(one: Member, other: Member) -> bool:
    a, b = one.scale_m_per_px, other.scale_m_per_px
    return abs(a - b) <= SAME_DISTANCE * max(abs(a), abs(b))


def _cause_text(verdict: Verdict) -> str:
    kept, other = verdict.kept, verdict.other
    if Cause.TILT not in verdict.open:
        return (
            "One of them moves on its own, such as a slow drift; neither the accelerometer nor a majority of targets "
            "shows which. Remove the doubtful target from camera.target, or add a third."
        )
    share = abs(_shares(kept, other)[Cause.TILT])
    named = [(member.name, abs(member.scale_m_per_px)) for member in (kept, other)]
    return tilt_text(named[0], named[1], share * verdict.size_m, decided=verdict.open == frozenset({Cause.TILT}))


def _shared_text(shared_m: float) -> str:
    return (
        f"All targets share image motion of {1e3 * shared_m:.2g} mm rms that the accelerometer does not show: the "
        "camera tilts, its bracket vibrates, or the frames' time stamps are wrong."
    )
