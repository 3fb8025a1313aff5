"""The figures of the radar: range profile, circle of the best target, its phase and speed, amplitudes over time."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.sensors.radar import RadarCalibration, RadarDiagnostics
from midspan.engine.radar_trace import RadarTrace, TargetTrace
from midspan.radar.blockage import MAX_SHARE, MIN_SHARE
from midspan.radar.channels import MIN_BINS
from midspan.radar.unwrap import TURN
from midspan.records import Floats, seconds
from midspan.report.drawing import Colour, Picture, draw_line, draw_points, legend, picture, sheet
from midspan.report.material import Clock
from midspan.report.thinning import Envelope, spans

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Targets whose amplitude is drawn, and refused peaks that are marked.
MAX_DRAWN, MAX_REFUSED = 5, 12
# The lowest and highest amplitude drawn, dB from the calibrated one.
FLOOR_DB, CEILING_DB = -30.0, 12.0


def profile(radar: RadarCalibration, found: RadarDiagnostics) -> Picture:
    """Power over range with the targets that are used and those that were refused."""
    figure = sheet(3.2)
    axes = figure.subplots()
    known = np.isfinite(found.range_m).all()
    x = found.range_m if known else np.arange(len(found.range_m), dtype=np.float64)
    if len(x) < MIN_BINS:
        axes.vlines(x, 0.0, found.power_db, color=Colour.BLUE, linewidth=3.0, label="power of the stored targets")
    else:
        axes.plot(x, found.power_db, color=Colour.BLUE, label="mean power")
    axes.axhline(0.0, color=Colour.BLACK, linewidth=0.8, linestyle="--", label="noise of a frame")
    _marks(axes, radar, found, x)
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, -12.0), high + 0.14 * (high - low))
    axes.set_xlabel("range (m)" if known else "bin")
    axes.set_ylabel("power over the noise (dB)")
    axes.margins(x=0.02 if len(x) >= MIN_BINS else 0.1)
    legend(axes, 5)
    return picture(figure)


def _marks(axes: "Axes", radar: RadarCalibration, found: RadarDiagnostics, x: Floats) -> None:
    """The peaks: used ones with rank and range, refused ones as crosses."""
    bins = np.arange(len(x))
    refused = sorted((item.target for item in radar.targets if not item.used), key=lambda target: -target.amplitude)
    for targets, marker, size, colour, label in (
        (radar.used, "o", 6, Colour.VERMILLION, "used"),
        (refused[:MAX_REFUSED], "x", 5, Colour.GREY, "not used"),
    ):
        places = np.array([target.place_bin for target in targets])
        x_at, y_at = np.interp(places, bins, x), np.interp(places, bins, found.power_db)
        axes.plot(x_at, y_at, linestyle="none", marker=marker, markersize=size, color=colour, label=label)
    for rank, target in enumerate(radar.used, start=1):
        at = (float(np.interp(target.place_bin, bins, x)), float(np.interp(target.place_bin, bins, found.power_db)))
        text = f"{rank}: {target.range_m:.2f} m" if np.isfinite(target.range_m) else f"{rank}"
        axes.annotate(
            text, at, xytext=(0, 7), textcoords="offset points", ha="center", fontsize=8, color=Colour.VERMILLION
        )


def circle(radar: RadarCalibration, found: RadarDiagnostics) -> Picture:
    """The best target's phasors in the plane of I and Q, with what is static taken for the centre."""
    figure = sheet(3.6)
    left, right = figure.subplots(1, 2)
    raw = found.phasors[np.isfinite(found.phasors)]
    size = radar.best.amplitude
    draw_points(left, raw.real, raw.imag, marker=".", markersize=2.0, color=Colour.BLUE, label="frames")
    ring = found.leak + size * np.exp(1j * np.linspace(0.0, TURN, 361))
    left.plot(ring.real, ring.imag, color=Colour.VERMILLION, linewidth=1.0, label="fitted")
    left.plot(found.leak.real, found.leak.imag, marker="+", markersize=10, color=Colour.VERMILLION, linestyle="none")
    left.plot(0.0, 0.0, marker="x", markersize=6, color=Colour.BLACK, linestyle="none", label="zero")
    left.set_aspect("equal", adjustable="datalim")
    left.set_xlabel("I (ADC counts)")
    left.set_ylabel("Q (ADC counts)")
    legend(left, 3)
    _radius(right, raw / size, found.leak / size)
    return picture(figure)


def _radius(axes: "Axes", share: NDArray[np.complex128], leak: complex) -> None:
    """Amplitude over phase, before and after what is static is taken out: flat is right."""
    used = share - leak
    if leak:
        draw_points(
            axes, np.angle(share), np.abs(share), marker=".", markersize=2.0, color=Colour.GREY, label="as received"
        )
    draw_points(axes, np.angle(used), np.abs(used), marker=".", markersize=2.0, color=Colour.BLUE, label="used")
    axes.axhline(1.0, color=Colour.VERMILLION, linewidth=1.0)
    axes.set_xlim(-np.pi, np.pi)
    axes.set_xticks([-np.pi, -np.pi / 2, 0.0, np.pi / 2, np.pi], ["−π", "−π/2", "0", "π/2", "π"])
    axes.set_ylim(0.0, max(1.6, 1.1 * float(np.quantile(np.abs(share), 0.99))))
    axes.set_xlabel("phase (rad)")
    axes.set_ylabel("amplitude / calibrated")
    legend(axes, 2)


def phase(trace: RadarTrace, clock: Clock) -> Picture:
    """The fastest seconds: phase as measured and unwrapped, and its speed with the limit of plain unwrapping."""
    found = trace.excerpt
    assert found is not None
    figure = sheet(4.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1))
    t = clock.at(found.time_ns)
    upper.plot(t, found.plain / TURN, color=Colour.ORANGE, linewidth=4.5, alpha=0.45, label="plain unwrapping")
    upper.plot(t, found.unwrapped / TURN, color=Colour.BLUE, linewidth=1.4, label="as used")
    draw_points(upper, t, found.wrapped / TURN, marker=".", markersize=3.0, color=Colour.BLACK, label="as measured")
    upper.set_ylabel("phase (cycles)")
    legend(upper, 3)
    # Half a cycle of range from frame to frame is the limit.
    own_s = seconds(found.time_ns, int(found.time_ns[0]))
    per_cycle = 2.0 * trace.limit_speed_m_s * float(np.median(np.diff(own_s)))
    speed = 1e3 * per_cycle * (np.diff(found.unwrapped) / TURN / np.diff(own_s))
    lower.plot(0.5 * (t[1:] + t[:-1]), speed, color=Colour.BLUE, label="speed in the line of sight")
    for sign in (-1.0, 1.0):
        label = f"limit of plain unwrapping, ±{1e3 * trace.limit_speed_m_s:.3g} mm/s" if sign > 0 else None
        lower.axhline(
            sign * 1e3 * trace.limit_speed_m_s, color=Colour.VERMILLION, linewidth=1.0, linestyle="--", label=label
        )
    lower.set_ylabel("speed (mm/s)")
    lower.set_xlabel(clock.label)
    lower.margins(x=0.005)
    low, high = lower.get_ylim()
    lower.set_ylim(low, high + 0.3 * (high - low))
    lower.legend(loc="upper left", ncols=2)
    figure.align_ylabels()
    return picture(figure)


def amplitudes(trace: RadarTrace, clock: Clock) -> Picture:
    """Phase of the best target over the whole record, and below the amplitude of each with the limits of blockage."""
    shown = trace.targets[:MAX_DRAWN]
    figure = sheet(1.7 + 1.15 * len(shown))
    first, *others = figure.subplots(1 + len(shown), 1, sharex=True, height_ratios=(1.5, *(1.0 for _ in shown)))
    t = clock.at(shown[0].time_ns)
    draw_line(first, Envelope(t, trace.low / TURN, trace.high / TURN, whole=False), Colour.BLUE, "unwrapped phase")
    first.set_ylabel("phase (cycles)")
    for time_s in clock.at(shown[0].restarts_ns):
        first.axvline(time_s, color=Colour.VERMILLION, linewidth=0.9, linestyle=":")
    for rank, (axes, target) in enumerate(zip(others, shown, strict=True), start=1):
        _amplitude(axes, target, clock)
        where = f" at {target.range_m:.2f} m" if np.isfinite(target.range_m) else ""
        axes.set_title(f"target {rank}{where}", fontsize=8.5, loc="left")
    others[-1].set_xlabel(clock.label)
    first.margins(x=0.005)
    figure.align_ylabels()
    return picture(figure)


def _amplitude(axes: "Axes", target: TargetTrace, clock: Clock) -> None:
    t = clock.at(target.time_ns)
    for share in (MIN_SHARE, MAX_SHARE):
        axes.axhline(20.0 * np.log10(share), color=Colour.GREY, linewidth=0.8, linestyle="--")
    blocked = spans(t, target.used < 0.5)
    if blocked:
        axes.broken_barh(
            blocked, (0, 1), transform=axes.get_xaxis_transform(), color=Colour.ORANGE, alpha=0.3, linewidth=0.4
        )
    low, high = (np.clip(20.0 * np.log10(np.maximum(v, 1e-6)), FLOOR_DB, CEILING_DB) for v in (target.low, target.high))
    axes.fill_between(t, low, high, color=Colour.SKY, alpha=0.6, linewidth=0)
    axes.plot(t, 0.5 * (low + high), color=Colour.BLUE, linewidth=0.8)
    for time_s in clock.at(target.restarts_ns):
        axes.axvline(time_s, color=Colour.VERMILLION, linewidth=0.9, linestyle=":")
    axes.set_ylim(FLOOR_DB, CEILING_DB)
    axes.set_yticks([-20.0, 0.0])
    axes.set_ylabel("amplitude\n(dB)")
