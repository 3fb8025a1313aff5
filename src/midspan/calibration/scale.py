"""The scale factor and clock offset of a camera from a minute with an accelerometer, or a refusal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from midspan.calibration.agreement import clearly_better, misfit
from midspan.calibration.clock_jumps import ClockJump, jumps_text, lead_of_halves, without_jumps
from midspan.calibration.direction import Direction, turned
from midspan.calibration.fit import MIN_FRAMES, Fit, Pair, aligned, best_corner, with_input_noise
from midspan.calibration.frequency_response import FrequencyResponse, response_of, with_response
from midspan.calibration.frequency_shapes import Kind, kinds_of
from midspan.calibration.gain_drift import drift_text, gain_drift
from midspan.calibration.own_error import OwnError, find_own_error
from midspan.calibration.own_noise import contradiction, exceeds_own_noise
from midspan.calibration.time_offset import OffsetSearch, Rival, likeliest_beyond, search_offset
from midspan.calibration.whitening import SETTLING
from midspan.checks import instance
from midspan.errors import NoAgreementError, UntrustedError
from midspan.notices import Notice, rounded
from midspan.records import Floats, InputNoise, NoiseLevel, ScaleFactor, TimeOffset
from midspan.signals.health import dominant_frequency
from midspan.signals.medians import SIGMA_OF_MEDIAN, white_noise

# mm/px is distance × pixel pitch ÷ focal length: 500 is a phone's wide lens (0.7 mm/px a metre at 1920 px) 700 m away,
# where a tracker's 0.01 px are 5 mm. Beyond it the ratio is that of two things that do not move alike.
LARGEST_M_PER_PX = 0.5
# How often the clock offset is searched anew with what depends on frequency taken out: it then shows more.
ANEW = 2
# Image motion above this many standard deviations of a frame's noise is motion; above fewer it likely is.
CLEARLY_MOVING, LIKELY_MOVING = 8.0, 4.0
# Where more than this share of the frames would be outliers, a clock that jumps is looked for: after one all are.
MANY_LEFT_OUT = 0.2
# The largest relative standard deviation of a scale factor that is still given out, and the one that brings a warning.
REFUSED_ABOVE = 0.05
WARNED_ABOVE = 0.01
# A scale factor that changes was right at its begin or its end, and begins faster than the polynomials that follow it:
# this many deviations reach from the one to the other.
WITHIN = 1.5
# What the relative standard deviation of a camera's scale factor is made of: each part in words, and what lessens it.
PARTS = {
    "motion": (
        "too little motion for the noise",
        "Choose a calibration.window_s with more motion, or a longer one.",
    ),
    "compression": (
        "video compression",
        "Record raw or lossless, or with more pixels per mm: nearer, or with a longer lens.",
    ),
    "pattern": (
        "the thermal camera's fixed pattern, which may bias translations towards zero",
        "Choose a target with more contrast or motion in the image.",
    ),
    "response": (
        "an exposure or a logger's low-pass, which attenuates fast motion",
        "Declare camera.exposure_s, and set the low-pass far above the motion.",
    ),
    "misfit": (
        "a difference of the two sensors that is not white noise",
        "Check for cross motion, tilt and a soft mounting.",
    ),
    "printed": (
        "the difference of the printed steps (calibration.literal) from the likelihood",
        "Leave literal out, or track with less noise: mismatches bias the printed fit towards zero.",
    ),
    "gain": (
        "the accelerometer's sensitivity (accelerometer.scale_std)",
        "Calibrate the accelerometer, or compare it with a displacement sensor.",
    ),
}
# Gain of the logarithmic likelihood that the acceleration must bring. Scanning some hundred offsets lets pure noise
# gain about ln(200) + 3; ten more is one chance in twenty thousand.
MIN_GAIN = 20.0
# The difference of image and acceleration that is refused: this many times a frame's noise, this share of the motion.
UNEXPLAINED_NOISE = 5.0
UNEXPLAINED_SHARE = 0.2
# Accelerometer noise that the difference would need, refused above this share of the signal when it is also this many
# times the noise that the signal itself shows (a noisy accelerometer with a slow motion is no disagreement).
IMPLIED_SHARE = 0.3
IMPLIED_NOISE = 4.0
# An alias below this is reported as the likely reason of a refusal: bias and drift of a minute look the same.
SLOW_ALIAS_HZ = 0.05
# Frames that the zero rests on, and how many times noisier than usual they are noisier for certain: of frames alike the
# median of this many exceeds that once in a million.
START_FRAMES, START_NOISE = 16, 2.5
# What decides between two offsets that fit alike where nothing is said of the clocks.
OPEN_CLOCKS = (
    "without a limit on the clock offset, as with nearly a single tone. Set calibration.max_offset_s to the largest "
    "possible offset (with two files: in the recording.toml that `midspan init` writes)"
)
# Causes of every disagreement that show in no figure.
NOT_SHOWN = (
    "Other causes look the same: lost or doubled frames without time stamps (give each frame one), a wrong "
    "camera.rate_hz (slow-motion video), cross motion on an inclined axis, a vibrating camera or bracket, a low-pass "
    "in the accelerometer's logger, a loose or clipped accelerometer."
)

DIRECTION = "camera.direction (with two files: --direction)"


def of_no_camera(scale_m_per_px: float) -> str:
    """A sentence where a scale factor is out of any camera's reach, else empty."""
    if abs(scale_m_per_px) <= LARGEST_M_PER_PX:
        return ""
    return (
        f"Check {DIRECTION} first: more than {1e3 * LARGEST_M_PER_PX:g} mm/px, as here, is implausible; the motion is "
        "probably along the other image axis. "
    )


def too_vague(scale_m_per_px: float, relative_std: float) -> str:
    """What is refused for its standard deviation, without a figure that no camera can have."""
    figure = f"{1e3 * scale_m_per_px:.4g} mm/px " if abs(scale_m_per_px) <= LARGEST_M_PER_PX else "an uncertainty of "
    return f"{figure}± {rounded(100 * relative_std)} %; at most ± {100 * REFUSED_ABOVE:g} % is accepted"


@dataclass(frozen=True, slots=True)
class ScaleCalibration:
    """Scale factor, clock offset and noise of one camera.

    noise: standard deviation of the translation, px; variance_factor: estimated variance over the tracker's own
    variance; input_noise: of the acceleration; search: what was tried, for the report; response: what depends on
    frequency, whose uncertainty is not in the scale factor's; warnings: sentences; direction: of the camera's axis,
    None where no cross axes were recorded; own: the camera's slow error, in the search's pair and fit;
    felt_alone: whether what the two differ by is the accelerometer's for certain.
    """

    scale: ScaleFactor
    search: OffsetSearch
    noise: NoiseLevel
    variance_factor: float
    input_noise: InputNoise
    warnings: tuple[Notice, ...]
    response: FrequencyResponse = field(default_factory=FrequencyResponse)
    direction: Direction | None = None
    own: OwnError | None = None
    felt_alone: bool = False


def calibrate_scale(
    pair: Pair,
    max_offset_s: float,
    *,
    exposure_declared: bool = False,
    clocks_open: bool = False,
    slow_errors: bool = True,
) -> ScaleCalibration:
    """Estimate scale factor (signed), time offset and noise levels by maximum likelihood.

    pair: translation in px with the tracker's variances, and the acceleration, of about one minute.
    max_offset_s: largest clock offset searched for, s; exposure_declared: whether the pair's exposure is the camera's
    own; clocks_open: whether the clocks may be farther apart than `max_offset_s`, so that an offset beyond it that fits
    alike is refused too; slow_errors: whether those are looked for. Raises UntrustedError with the reason: too little
    motion, two offsets that fit alike, sensors that do not agree; NoAgreementError where they do beyond the range.
    """
    instance("pair", pair, Pair, "a Pair of acceleration and translation")
    usable = int(np.count_nonzero(np.isfinite(pair.rows[:, 2])))
    _refuse_few(usable, max_offset_s)
    typical = float(np.median(pair.rows[np.isfinite(pair.rows[:, 2]), 2]))
    # Relative variances near 1 keep the corner frequency what its name says, and the diffuse start above all noise.
    axis = turned(pair.changed(rows=pair.rows / np.array([1.0, 1.0, typical])), max_offset_s)
    pair = axis.pair
    kinds = kinds_of(pair, exposure_declared=exposure_declared)
    jumps: Sequence[ClockJump] = ()

    refuse = partial(_refuse_untrusted, noise=float(np.sqrt(typical)), reach=(max_offset_s, clocks_open))
    refusal: UntrustedError | None = None
    search, response = with_frequency(search_offset(pair, max_offset_s), pair, max_offset_s, kinds)
    try:
        refuse(search)
    except UntrustedError as error:
        refusal = error
    many = np.mean(np.isinf(search.pair.rows[:, 2])) > MANY_LEFT_OUT
    # What a clock that steps leaves is noise of either, or the motion's own frequencies, as where a camera sways.
    if refusal is not None or many or lead_of_halves(search.pair, search.fit) > MIN_GAIN:
        moved, jumps = without_jumps(pair, max_offset_s, refuse)
        if jumps:
            pair = moved
            search, response = with_frequency(search_offset(pair, max_offset_s), pair, max_offset_s, kinds)
            refuse(search)
        elif refusal is not None:
            _refuse_better(pair, _rival(pair, search, max_offset_s), max_offset_s, refuse, accepted=False)
            raise refusal
    _refuse_rivals(pair, search, refuse, (max_offset_s, clocks_open), float(np.sqrt(typical)))
    drift, own, felt_alone = _slow_errors(search, typical, response) if slow_errors else (0.0, None, False)
    search = axis.widened(search if own is None or not own.taken else replace(search, pair=own.pair, fit=own.fit))
    fit = search.fit
    return ScaleCalibration(
        scale=ScaleFactor(1.0 / fit.ratio, (fit.relative_std / fit.ratio) ** 2),
        search=search,
        noise=NoiseLevel(float(np.sqrt(fit.noise))),
        variance_factor=fit.noise / typical,
        input_noise=search.pair.input_noise(fit.input_density),
        warnings=(*jumps_text(jumps), *_warnings(search, usable), *_texts(response, fit, drift)),
        response=replace(response, relative_std=float(np.hypot(response.relative_std, drift / WITHIN))),
        direction=axis.direction,
        own=own,
        felt_alone=felt_alone,
    )


def _texts(response: FrequencyResponse, fit: Fit, drift: float) -> tuple[Notice, ...]:
    return (*response.texts(fit.motion_hz), *drift_text("camera", drift))


def _refuse_untrusted(search: OffsetSearch, *, noise: float, reach: tuple[float, bool]) -> None:
    max_offset_s, clocks_open = reach
    remedy = "raise calibration.max_offset_s or set camera.start_s"
    clocks = f"Clock offsets within ±{max_offset_s:g} s were searched: if they may differ by more, {remedy}."
    if clocks_open:
        clocks = "Clock offsets up to half of the film were searched: if they may differ by more, set camera.start_s."
    _refuse_no_motion(search.pair, search.fit, noise, clocks)
    _refuse_disagreement(search.pair, search.fit, noise, clocks)
    _refuse_ambiguity(search, max_offset_s)


def _slow_errors(
    search: OffsetSearch, typical: float, response: FrequencyResponse
) -> tuple[float, OwnError | None, bool]:
    """A gain that drifts as of `gain_drift`, and as of `find_own_error`; what goes with the motion, as such a gain, is
    no sway of the camera.
    """
    drift = gain_drift(search.pair, search.fit)
    own, felt_alone = find_own_error(search.pair, search.fit, typical)
    if (drift > 0.0 or response.accelerometer_errs) and (own is None or own.sways):
        own, felt_alone = None, True
    # What a mounting that resonates errs by is more than its shape.
    return drift, own, felt_alone and Kind.RESONANCE not in response.known


def _refuse_few(usable: int, max_offset_s: float) -> None:
    if usable < MIN_FRAMES:
        raise UntrustedError(
            f"Only {usable} usable frames lie in the calibration window (frames within calibration.max_offset_s = "
            f"{max_offset_s:g} s of its ends are left out); at least {MIN_FRAMES} are needed. Widen "
            "calibration.window_s, lower calibration.max_offset_s, or check camera.roi if the target was lost."
        )


def with_frequency(
    plain: OffsetSearch, pair: Pair, max_offset_s: float, kinds: Sequence[Kind]
) -> tuple[OffsetSearch, FrequencyResponse]:
    """The search with what depends on frequency taken out, as far as it shows; plain: the search without."""
    search, known, doubt, open_s2, open_change = plain, list[Kind](), 0.0, 0.0, 0.0
    for _ in range(ANEW):
        if search.fit.gain < MIN_GAIN:
            return search, FrequencyResponse()
        one = with_response(search.pair, search.fit, kinds, known)
        open_s2, open_change = one.open_s2, one.open_change
        if one.known == known:
            break
        doubt = float(np.hypot(doubt, one.doubt))
        # Outliers are judged anew: what depends on frequency looked like some.
        known = one.known
        search = search_offset(one.pair.changed(rows=pair.rows, reference=None), max_offset_s)
    if known and contradiction(search.pair, search.fit) > 0.0:
        # What they differ by is something else, which a function of frequency may only happen to resemble.
        doubt = float(np.hypot(doubt, search.fit.ratio / plain.fit.ratio - 1.0))
        search, known = plain, []
    if open_change != 0.0:
        # Both explanations are as likely: the ratio lies between them.
        search = _at_ratio(search, search.fit.ratio * (1.0 + 0.5 * open_change))
    doubt = float(np.hypot(doubt, 0.5 * open_change))
    response = response_of(search.pair, search.fit, kinds, known, declared_s=pair.exposure_s, open_s2=open_s2)
    # The read-out's rows are no part of the exposure.
    own_s = float(np.sqrt(max(response.exposure_s**2 - pair.exposure_s**2, 0.0)))
    offset = TimeOffset(search.offset.value_s, search.offset.variance + response.offset_variance)
    search = replace(search, offset=offset)
    response = replace(response, exposure_s=own_s, relative_std=float(np.hypot(response.relative_std, doubt)))
    if search.pair.logger != (0.0, 0.0):
        # The low-pass stays in the acceleration, whose noise levels are those with it.
        search = _at_ratio(replace(search, pair=search.pair.changed(logger=(0.0, 0.0))), search.fit.ratio)
    return search, response


def _at_ratio(search: OffsetSearch, ratio: float) -> OffsetSearch:
    pair = search.pair.changed(ratio=ratio)
    pair, fit = with_input_noise(pair, best_corner(pair, search.fit.offset_s))
    return replace(search, pair=pair, fit=replace(fit, ratio_variance=search.fit.ratio_variance))


def _refuse_no_motion(pair: Pair, fit: Fit, noise: float, clocks: str) -> None:
    gain, relative = fit.gain, fit.relative_std
    if gain >= MIN_GAIN and relative <= REFUSED_ABOVE:
        return
    rows = pair.rows[np.isfinite(pair.rows[:, 2])]
    seen, shaken = float(np.std(rows[:, 1])), float(np.std(pair.samples[:, 1]))
    moved = f"image motion {seen:.3g} px rms with noise {noise:.2g} px"
    figures = f"Found: {moved}, acceleration {1e3 * shaken:.3g} mm/s² rms."
    slow, no_agreement = _slow_samples(pair), "No agreement between image and accelerometer:"
    if seen > CLEARLY_MOVING * noise and gain < MIN_GAIN:
        check = slow or (
            f"Check {DIRECTION}, accelerometer.value, camera.roi, camera.rate_hz, and that both files are of the same "
            "event."
        )
        raise NoAgreementError(
            f"{no_agreement} the image moves, but not with the acceleration. {check}",
            more=f"{figures} The region must show a fixed target for a camera on the structure, the structure at the "
            f"accelerometer for a camera on a tripod. {clocks} {NOT_SHOWN}",
        )
    would_be = too_vague(1.0 / fit.ratio, relative)
    alias, shakes = alias_in_words(pair), shaken > CLEARLY_MOVING * white_noise(pair.samples[:, 1])
    first = of_no_camera(1.0 / fit.ratio) if shakes else ""
    livelier = (
        "Choose a calibration.window_s with traffic or shaking, or pass a calibration made at a livelier time with -c. "
    )
    if seen > LIKELY_MOVING * noise and shakes and not alias:
        # What moves for certain, and otherwise, contradicts.
        contradicts = seen > CLEARLY_MOVING * noise
        check = slow or first or "Check camera.roi, camera.direction, and that both files are of the same event."
        text = f"{no_agreement} both move, but too differently for a scale factor. {check}".rstrip()
        more = f"{figures} The scale factor would be {would_be}. Check accelerometer.value. {clocks} "
        more += f"{'' if contradicts else livelier}{NOT_SHOWN}"
        raise NoAgreementError(text, more=more) if contradicts else UntrustedError(text, more)
    static = (
        f"check {DIRECTION}, camera.roi (an object fixed to the camera shows no motion), and that no stabiliser "
        "removes the motion."
    )
    if shakes and not alias:
        raise UntrustedError(
            f"Too little motion in the image: the accelerometer moves, the image does not: {slow or static}".rstrip(),
            f"{figures} The scale factor would be {would_be}. Check that both files are of the same event. {clocks} "
            f"{livelier}".rstrip(),
        )
    why = slow or alias
    raise UntrustedError(
        f"Too little motion to calibrate the scale factor{f'. {why}' if why else f' ({moved}). {livelier}'}".rstrip(),
        f"{figures} The scale factor would be {would_be}. {first}If the structure did move, {static} {clocks} "
        f"{livelier if why else ''}".rstrip(),
    )


def _slow_samples(pair: Pair) -> str:
    if pair.sample_rate_hz > pair.rate_hz:
        return ""
    return (
        f"The accelerometer has {pair.sample_rate_hz:.3g} samples per second, fewer than the camera's "
        f"{pair.rate_hz:.3g} frames: check whether its times are in ms (they are read as s) and whether its file was "
        "decimated. "
    )


def _rival(pair: Pair, search: OffsetSearch, max_offset_s: float) -> Rival | None:
    return likeliest_beyond(search.pair.changed(ratio=pair.ratio, logger=(0.0, 0.0)), search.fit, max_offset_s)


def _refuse_rivals(
    pair: Pair, search: OffsetSearch, refuse: Callable[[OffsetSearch], None], clocks: tuple[float, bool], usual: float
) -> None:
    """UntrustedError where another offset is the right one, or may be; clocks: how far, s, and whether more."""
    max_offset_s, clocks_open = clocks
    noise = (search.pair, search.fit)
    if not clocks_open and not exceeds_own_noise(*noise) and misfit(*noise).factor <= 1.0:
        return
    rival = _rival(pair, search, max_offset_s)
    _refuse_better(pair, rival, max_offset_s, refuse, accepted=True)
    if not clocks_open or rival is None or not rival.alike:
        return
    # One that is even the likelier one must be acceptable itself.
    if rival.lead <= 0.0:
        try:
            _refuse_disagreement(pair, rival.fit, usual, "")
        except UntrustedError:
            return
    raise UntrustedError(_alike_text(search.fit, rival.fit, OPEN_CLOCKS))


def _refuse_better(
    pair: Pair, rival: Rival | None, max_offset_s: float, refuse: Callable[[OffsetSearch], None], *, accepted: bool
) -> None:
    """A refusal where image and acceleration agree better beyond; accepted: whether the best fit within would be."""
    if rival is None or not rival.better:
        return
    offset_s = rival.fit.offset_s
    try:
        refuse(search_offset(pair.changed(rows=pair.rows + np.array([offset_s, 0.0, 0.0])), max_offset_s))
    except UntrustedError as error:
        if not accepted:
            return
        raise UntrustedError(
            f"Image and accelerometer agree better at a clock offset of {offset_s:+.3g} s than anywhere within "
            f"±{max_offset_s:g} s, but that fit is not trustworthy either. Check camera.start_s, camera.roi, and that "
            "both files are of the same event.",
            f"{error} {error.more}".rstrip(),
        ) from None
    raise NoAgreementError(
        f"No agreement between image and accelerometer within ±{max_offset_s:g} s: their clocks seem to differ by "
        f"{offset_s:+.3g} s. Add this to camera.start_s or to the frames' time stamps, or raise "
        "calibration.max_offset_s above it.",
        offset_s,
    )


def _refuse_disagreement(pair: Pair, fit: Fit, usual: float, clocks: str) -> None:
    rows = pair.rows[np.isfinite(pair.rows[:, 2])]
    moved, left = float(np.std(rows[:, 1])), float(np.sqrt(fit.noise))
    if left > max(UNEXPLAINED_NOISE * usual, UNEXPLAINED_SHARE * moved):
        raise NoAgreementError(
            f"No agreement between image and accelerometer: {left:.2g} px of the image's {moved:.2g} px rms remain "
            f"unexplained; the noise of a frame is {usual:.2g} px. "
            f"{_slow_samples(pair) or 'Check camera.roi, camera.direction and camera.rate_hz.'}".rstrip(),
            more=f"{clocks} {NOT_SHOWN}",
        )
    if needed := noise_needed(pair, fit):
        raise NoAgreementError(
            f"No agreement between image and accelerometer: {needed}. Check that both files are of the same event, "
            "camera.direction, camera.roi and accelerometer.unit.",
            more=f"Its noise is about {1e3 * white_noise(pair.samples[:, 1]):.2g} mm/s². {clocks} {NOT_SHOWN}",
        )


def noise_needed(pair: Pair, fit: Fit) -> str:
    """What to tell where only a noise that the accelerometer does not have explains its difference; else empty."""
    implied, own = float(np.sqrt(fit.input_density * pair.sample_rate_hz)), white_noise(pair.samples[:, 1])
    measured = float(np.std(pair.samples[:, 1]))
    if implied <= measured and (implied <= IMPLIED_SHARE * measured or implied <= IMPLIED_NOISE * own):
        return ""
    return (
        f"their difference implies accelerometer noise of {1e3 * implied:.3g} mm/s² per sample, but the signal has "
        f"{1e3 * measured:.3g} mm/s² rms"
    )


@dataclass(frozen=True, slots=True)
class StartNoise:
    """What the first frames differ by from the acceleration, in the translation's unit; 0: as all others do.

    drifts: whether another gain and bias of the accelerometer explain it, as while it warms up, and no noise does.
    """

    std: float
    drifts: bool = False


def start_noise(pair: Pair, fit: Fit) -> StartNoise:
    """What the first frames differ by from the acceleration where that is clearly more than usual.

    Outliers count as well: frames that are all noisier than the rest seem to be some.
    """
    rows = pair.rows.copy()
    first = rows[: SETTLING + START_FRAMES, 2]
    first[np.isinf(first)] = 1.0
    w = aligned(pair.changed(rows=rows), fit.offset_s).whitened(fit.corner)
    root = np.sqrt(w.variance[:START_FRAMES])
    left, felt = (one[:START_FRAMES] / root for one in (w.translation - fit.ratio * w.response, w.response))
    clearly = START_NOISE * np.sqrt(fit.noise)
    if len(left) < START_FRAMES or (size := _spread(left)) <= clearly:
        return StartNoise(0.0)
    changed = np.column_stack((felt, np.ones(START_FRAMES)))
    return StartNoise(size, _spread(left - changed @ np.linalg.lstsq(changed, left, rcond=None)[0]) <= clearly)


def _spread(values: Floats) -> float:
    """Standard deviation of values (n,) about 0 by their median."""
    return SIGMA_OF_MEDIAN * float(np.sqrt(np.median(values**2)))


def uncertain_scale(sensor: str, relative_std: float, parts: Mapping[str, float]) -> list[Notice]:
    """A sentence where a scale factor is known to more than WARNED_ABOVE only; parts: of PARTS, relative."""
    if relative_std <= WARNED_ABOVE:
        return []
    largest = max(parts, key=lambda part: parts[part])
    cause, remedy = PARTS[largest]
    text = (
        f"{sensor}: the scale factor is uncertain by ± {100 * relative_std:.1f} % (one standard deviation); the "
        f"largest part, ± {100 * parts[largest]:.1f} %, comes from {cause}. {remedy}"
    )
    return [Notice("scale-uncertain", text)]


def alias_in_words(pair: Pair) -> str:
    """A sentence where the motion's main tone is nearly static in the slower sensor's samples, else empty."""
    tone = dominant_frequency(pair.samples[:, 1], pair.sample_rate_hz)
    alias = abs(tone - pair.rate_hz * round(tone / pair.rate_hz))
    if tone < 0.5 * pair.rate_hz or alias > SLOW_ALIAS_HZ:
        return ""
    return (
        f"The motion's main tone of {tone:.3g} Hz is aliased to {alias:.2g} Hz at {pair.rate_hz:.4g} measurements per "
        "second, too slow to separate from drift: record at a rate of which the tone is no multiple. "
    )


def is_ambiguous(search: OffsetSearch) -> bool:
    """Whether a second clock offset fits almost as well as the best one."""
    return search.runner_up is not None and not clearly_better(search.fit, search.runner_up)


def _refuse_ambiguity(search: OffsetSearch, max_offset_s: float) -> None:
    if search.runner_up is not None and is_ambiguous(search):
        within = f"within ±{max_offset_s:g} s, as with nearly a single tone, or with a tone whose "
        smaller = "alias meets a slower tone. Set a smaller calibration.max_offset_s that excludes one of them"
        raise UntrustedError(_alike_text(search.fit, search.runner_up, f"{within}{smaller}"))


def _alike_text(fit: Fit, other: Fit, where: str) -> str:
    return (
        f"The clock offset is ambiguous: {fit.offset_s:+.4f} s (scale factor {1e3 / fit.ratio:.4g} mm/px) and "
        f"{other.offset_s:+.4f} s ({1e3 / other.ratio:.4g} mm/px) fit almost equally well {where}, or calibrate on a "
        "time with changing motion."
    )


def _warnings(search: OffsetSearch, usable: int) -> Iterator[Notice]:
    std = float(np.sqrt(search.offset.variance))
    if std > 2e-3:
        text = f"The clock offset is uncertain by ± {1e3 * std:.1f} ms (one standard deviation). "
        text += "Choose a calibration.window_s with more motion of changing frequency."
        yield Notice("clock-uncertain", text)
    left_out = usable - int(np.count_nonzero(np.isfinite(search.pair.rows[:, 2])))
    if left_out > 0.05 * usable:
        text = f"{left_out} of {usable} frames were left out of the calibration as outliers. Check whether something "
        yield Notice("outliers", f"{text}occludes the target; choose camera.roi or calibration.window_s without it.")
