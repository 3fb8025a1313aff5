"""`two-stage-fir`: what a slow displacement aliases is first taken off with the accelerometer, then two branches add.

Stage one takes off each displacement, at its own instant, the acceleration-based displacement above the anti-aliasing
filter's transition band (from the cut-off f_c to half the displacement's rate). Stage two adds its low-pass and the
acceleration-based displacement's high-pass, complementary equiripple filters with the transition band up to f_c.

Reference: Z. Ma, P. Liu, J. Choi, H. Sohn, High-sampled structural displacement estimation through the FIR filter-based
two-stage fusion of high-sampled acceleration and temporally aliased low-sampled displacement measurements, sections 2.2
and 2.3.
"""

from dataclasses import dataclass, field

from midspan.checks import refuse
from midspan.fusion.methods import MAX_TAPS, MIN_TAPS, SPLINE_FRAMES
from midspan.fusion.streams import KalmanSettings, MethodSettings, Smoothed
from midspan.papers.printed.branches import Branches, Rates, check_spline_frames
from midspan.papers.printed.complementary import fused, smoothed_record
from midspan.papers.printed.filters import Transition, complement, equiripple_low_pass, equiripple_of_length
from midspan.papers.printed.fir import at_frames
from midspan.papers.printed.integrate import integrating
from midspan.records import Acceleration, Displacement, Estimate, Floats

# Least width of the anti-aliasing filter's transition band, Hz: half the displacement's rate is at least f_c + this.
MIN_WIDTH_HZ = 0.5
# Above this share of the accelerometer's rate nothing can alias.
HIGHEST_NYQUIST = 0.4


@dataclass(frozen=True, slots=True)
class TwoStageSettings:
    """Transition bands and ripples.

    band: of the complementary pair, from where only the displacement counts to where only the acceleration does; its
    stop_hz is the cut-off f_c. A wider band shortens the delay, a higher one leaves less to the accelerometer.
    anti_alias_ripple: of the anti-aliasing filter, relative amplitude. literal: the double integral by the trapezoidal
    rule, as the paper's; otherwise Numerov's. taps, anti_alias_taps: length of the pair and of the anti-aliasing
    filter, odd; None: the shortest that keeps the ripple. Fewer shortens the delay by half a sample each and lets more
    of the other band through. spline_frames: displacements after an interval that the spline to the accelerometer's
    grid looks at, 0 to 4; fewer shortens the delay by a displacement interval each.
    """

    band: Transition = field(default_factory=lambda: Transition(0.5, 1.0))
    anti_alias_ripple: float = 1e-3
    literal: bool = False
    taps: int | None = None
    anti_alias_taps: int | None = None
    spline_frames: int = SPLINE_FRAMES

    def __post_init__(self) -> None:
        Transition(1.0, 2.0, self.anti_alias_ripple)
        for name in ("taps", "anti_alias_taps"):
            value = getattr(self, name)
            if value is not None and not (value % 2 and MIN_TAPS <= value <= MAX_TAPS):
                raise refuse(name, f"an odd number from {MIN_TAPS} to {MAX_TAPS}", value)
        check_spline_frames(self.spline_frames)

    @property
    def rule(self) -> str:
        """The integration rule."""
        return "trapezoid" if self.literal else "numerov"


def least_rate_hz(cut_off_hz: float) -> float:
    """Smallest rate (Hz) of the displacement for a cut-off f_c (Hz): 2 (f_c + 0.5), two-stage paper, equation 1."""
    return 2.0 * (cut_off_hz + MIN_WIDTH_HZ)


def design(rates: Rates, settings: TwoStageSettings) -> Branches:
    """The complementary pair and the anti-aliasing filter for given rates, with a warning where the rate is too low.

    Raises UsageError where the band reaches half the accelerometer's rate.
    """
    rate_hz, nyquist_hz = 1.0 / rates.step_s, 0.5 / rates.frame_s
    low = _low_pass(settings.band, rate_hz, settings.taps)
    knots = settings.spline_frames
    high = integrating(complement(low), rates.step_s, rule=settings.rule)
    cut_off_hz = settings.band.stop_hz
    # A few parts in a million: rates estimated from stamps are not exact.
    if 2.0 * nyquist_hz < least_rate_hz(cut_off_hz) * (1.0 - 1e-3):
        # Below the least rate the complementary high-pass is the anti-aliasing filter too.
        removed = at_frames(low, rates, settings.rule)
        return Branches(low, high, settings.rule, removed, knots, (_too_slow(rates, settings),))
    if nyquist_hz * rates.step_s > HIGHEST_NYQUIST:
        return Branches(low, high, settings.rule, spline_frames=knots)
    band = Transition(cut_off_hz, nyquist_hz, settings.anti_alias_ripple)
    anti_alias = _low_pass(band, rate_hz, settings.anti_alias_taps)
    return Branches(low, high, settings.rule, at_frames(anti_alias, rates, settings.rule), knots)


def _low_pass(band: Transition, rate_hz: float, taps: int | None) -> Floats:
    """The equiripple low-pass of `band` at `rate_hz` (Hz): of this many taps, or the shortest that keeps its ripple."""
    return equiripple_low_pass(band, rate_hz) if taps is None else equiripple_of_length(band, rate_hz, taps)


def two_stage_fir(
    acceleration: Acceleration, displacement: Displacement, settings: TwoStageSettings | None = None
) -> Estimate:
    """Fuse a whole record: one row a sample, from acceleration (n samples) and displacement (m) in time order."""
    smoothed = smoothed_record(acceleration, displacement, KalmanSettings())
    return fused(design, settings or TwoStageSettings(), (acceleration, displacement), smoothed).estimate


def run_two_stage(
    acceleration: Acceleration, displacement: Displacement, settings: MethodSettings, path: Smoothed | None
) -> Smoothed:
    """The same as `on_series` of METHODS, see `fused`."""
    smoothed = path or smoothed_record(acceleration, displacement, settings.kalman)
    own = TwoStageSettings(
        band=Transition(*settings.transition_hz),
        literal=settings.literal,
        taps=settings.taps,
        anti_alias_taps=settings.anti_alias_taps,
        spline_frames=settings.spline_frames,
    )
    return fused(design, own, (acceleration, displacement), smoothed)


def _too_slow(rates: Rates, settings: TwoStageSettings) -> str:
    band = settings.band
    return (
        f"The displacement comes at {1.0 / rates.frame_s:.3g} Hz; the cut-off of {band.stop_hz:g} Hz needs at least "
        f"{least_rate_hz(band.stop_hz):g} Hz. Motion between {min(band.pass_hz, 0.5 / rates.frame_s):.3g} and "
        f"{band.stop_hz:g} Hz is weakened or aliased, and the band is wider for it; a faster displacement or a lower "
        "transition band mends that."
    )
