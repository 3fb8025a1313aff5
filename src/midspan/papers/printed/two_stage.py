"""`two-stage-fir`: what a slow displacement aliases is first taken off with the accelerometer, then two branches add.

Stage one takes off each displacement, at its own instant, the acceleration-based displacement above the anti-aliasing
filter's transition band (from the cut-off f_c to half the displacement's rate). Stage two adds its low-pass and the
acceleration-based displacement's high-pass, complementary equiripple filters with the transition band up to f_c.

Reference: Z. Ma, P. Liu, J. Choi, H. Sohn, High-sampled structural displacement estimation through the FIR filter-based
two-stage fusion of high-sampled acceleration and temporally aliased low-sampled displacement measurements, sections 2.2
and 2.3. The double integral is the trapezoidal rule's.
"""

from midspan.checks import refuse
from midspan.fusion.on_series import Usual
from midspan.fusion.streams import MethodSettings
from midspan.papers.printed.filters import Transition, complement, equiripple_low_pass, equiripple_of_length
from midspan.papers.printed.fir_rows import AtFrames, Branches, FirRows
from midspan.papers.printed.integrate import integrating
from midspan.records import Floats

# Least width of the anti-aliasing filter's transition band, Hz: half the displacement's rate is at least f_c + this.
MIN_WIDTH_HZ = 0.5
# Above this share of the accelerometer's rate nothing can alias.
MAX_NYQUIST = 0.4


def least_rate_hz(cut_off_hz: float) -> float:
    """Smallest rate (Hz) of the displacement for a cut-off f_c (Hz): 2 (f_c + 0.5), two-stage paper, equation 1."""
    return 2.0 * (cut_off_hz + MIN_WIDTH_HZ)


def design(settings: MethodSettings, usual: Usual) -> Branches:
    """The complementary pair and the anti-aliasing filter for the steps of both series, with a warning where the
    displacement is too slow.

    Raises UsageError where the band reaches half the accelerometer's rate.
    """
    rate_hz, nyquist_hz, band = 1.0 / usual.step_s, 0.5 / usual.frame_s, Transition(*settings.transition_hz)
    if band.stop_hz >= 0.5 * rate_hz:
        raise refuse(
            "fusion.transition_hz", f"below half the accelerometer's rate ({0.5 * rate_hz:g} Hz)", band.stop_hz
        )
    low = _low_pass(band, rate_hz, settings.taps)
    high, removed, warnings = integrating(complement(low), usual.step_s), None, list[str]()
    # A few parts in a million: rates estimated from stamps are not exact.
    if 2.0 * nyquist_hz < least_rate_hz(band.stop_hz) * (1.0 - 1e-3):
        # Below the least rate the complementary high-pass is the anti-aliasing filter too.
        removed, warnings = _at_frames(low, usual.step_s), [_too_slow(band, nyquist_hz)]
    elif nyquist_hz * usual.step_s <= MAX_NYQUIST:
        anti_alias = _low_pass(Transition(band.stop_hz, nyquist_hz), rate_hz, settings.anti_alias_taps)
        removed = _at_frames(anti_alias, usual.step_s)
    return Branches(low, high, usual.step_s, usual.frame_s, settings.spline_frames, removed, warnings=tuple(warnings))


def two_stage_fir(settings: MethodSettings, usual: Usual) -> FirRows:
    """The method as a stream, see `fusion.on_series`."""
    return FirRows(design(settings, usual))


def _at_frames(low_pass: Floats, step_s: float) -> AtFrames:
    """The complement of a low-pass, from acceleration to displacement at any instant."""
    high_pass = complement(low_pass)
    return AtFrames(integrating(high_pass, step_s), step_s**2 * high_pass)


def _low_pass(band: Transition, rate_hz: float, taps: int | None) -> Floats:
    """The equiripple low-pass of `band` at `rate_hz` (Hz): of this many taps, or the shortest that keeps its ripple."""
    return equiripple_low_pass(band, rate_hz) if taps is None else equiripple_of_length(band, rate_hz, taps)


def _too_slow(band: Transition, nyquist_hz: float) -> str:
    return (
        f"The displacement comes at {2.0 * nyquist_hz:.3g} Hz; the cut-off of {band.stop_hz:g} Hz needs at least "
        f"{least_rate_hz(band.stop_hz):g} Hz. Motion between {min(band.pass_hz, nyquist_hz):.3g} and "
        f"{band.stop_hz:g} Hz is weakened or aliased, and the band is wider for it; a faster displacement or a lower "
        "transition band mends that."
    )
