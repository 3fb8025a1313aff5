"""The figures of the displacement: time history, error, zoom, spectra, innovations. Each one: Material → Picture."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.errors import DataError
from midspan.evaluate.metrics import Band, normalised_innovation, step_of
from midspan.evaluate.spectrum import SEGMENT_S, SEGMENTS, Mode, hann, spectrum, welch
from midspan.fusion.blocks import REJECTED
from midspan.records import NANOSECONDS, Floats, Innovation, Nanoseconds, Status, TimeSeries, part, seconds
from midspan.report.drawing import Colour, Picture, draw_line, draw_points, legend, picture, sheet
from midspan.report.material import BAND, Material, Measured
from midspan.report.thinning import envelope, logarithmic_means, spans
from midspan.signals.stamps import inside

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ZOOM_S = 8.0
# Of the highest natural frequency.
MODES_SHOWN = 3.0
MIN_VALUES = 64
MAX_SEGMENT = 2**16
# Of the reference under the estimate's line of 0.9, in points.
REFERENCE_WIDTH = 2.6
# Innovations are drawn to this many of their median standard deviations, or as far as 95 % of them lie.
CLIPPED_STD = 6.0
# Measurements that a zoom can show one by one.
MAX_CLEAR = 250


def history(material: Material) -> Picture:
    """The whole displacement with its band, the reference, and where no measurement supports it; below, σ, which a
    large motion hides.
    """
    figure = sheet(3.8)
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(4.0, 1.0))
    d, s = material.result.displacement_mm, material.result.displacement_std_mm
    band = envelope(material.t, d - BAND * s, d + BAND * s)
    axes.fill_between(band.t, band.low, band.high, color=Colour.SKY, alpha=0.45, linewidth=0, label="±1.96 σ")
    reference = _reference_within(material, slice(0, len(material.t)))
    if reference is not None:
        # Underneath, and wider than the estimate's line: where both agree it shows on either side.
        wide = {"linewidth": REFERENCE_WIDTH, "alpha": 0.6}
        draw_line(axes, envelope(*reference, reference[1]), Colour.VERMILLION, "reference", **wide)
    draw_line(axes, envelope(material.t, d, d), Colour.BLUE, "displacement")
    draw_line(below, envelope(material.t, s, s), Colour.BLUE, "σ")
    below.set_ylim(0.0, None)
    below.set_ylabel("σ (mm)")
    for one in (axes, below):
        _shade(one, material)
    _finish(axes, material, "displacement (mm)")
    axes.set_xlabel("")
    below.set_xlabel(material.clock.label)
    figure.align_ylabels()
    return picture(figure)


def error(material: Material) -> Picture:
    """Displacement minus reference, each counted from its own mean, with the band that the result claims for that."""
    found = material.comparison
    assert found is not None
    figure = sheet(2.3)
    axes = figure.subplots()
    s = 1e3 * Band(np.sqrt(material.result.estimate.variance_m2), material.result.zero_std_m).without_zero
    band = envelope(material.t, -BAND * s, BAND * s)
    label = "stated ±1.96 σ without the zero"
    axes.fill_between(band.t, band.low, band.high, color=Colour.SKY, alpha=0.45, linewidth=0, label=label)
    error_mm = found.error_mm - found.bias_mm
    drawn = envelope(material.clock.at(found.time_ns), error_mm, error_mm)
    draw_line(
        axes, drawn, Colour.VERMILLION, f"result − reference, mean of {found.bias_mm:.3g} mm removed", linewidth=0.8
    )
    axes.axhline(0.0, color=Colour.BLACK, linewidth=0.8, linestyle="--")
    _shade(axes, material)
    # A band that grows beyond all in a gap must not hide the error itself.
    limit = 1.15 * max(float(np.max(np.abs(error_mm))), float(np.quantile(BAND * s, 0.97)), 1e-9)
    axes.set_ylim(-limit, limit)
    _finish(axes, material, "error (mm)")
    return picture(figure)


def _shade(axes: "Axes", material: Material) -> None:
    """Coasting and lost segments as coloured grounds over the whole height."""
    status = material.result.estimate.status
    for code, colour in ((Status.COASTING, Colour.ORANGE), (Status.LOST, Colour.VERMILLION)):
        found = spans(material.t, status == code)
        if found:
            ground = axes.get_xaxis_transform()
            label = code.word
            axes.broken_barh(found, (0, 1), transform=ground, color=colour, alpha=0.28, linewidth=0.4, label=label)


def _finish(axes: "Axes", material: Material, label: str) -> None:
    axes.set_xlabel(material.clock.label)
    axes.set_ylabel(label)
    axes.margins(x=0.005)
    legend(axes, 6)


def liveliest(material: Material) -> slice:
    """The rows of the segment of about eight seconds with the largest rms velocity."""
    rows = material.result.estimate
    slowest = min((m.rate_hz for m in material.measured), default=10.0)
    length_s = min(max(ZOOM_S, 12.0 / slowest), 40.0)
    step_s = float(np.median(np.diff(rows.time_ns))) / 1e9
    count = min(max(int(length_s / step_s), 2), len(rows.time_ns))
    power = np.concatenate(([0.0], np.cumsum(rows.velocity_m_s**2)))
    start = int(np.argmax(power[count:] - power[:-count]))
    return slice(start, start + count)


def zoom(material: Material) -> Picture:
    """The liveliest seconds with what the sensors measured; below, everything with the displacement taken away."""
    which = liveliest(material)
    figure = sheet(4.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
    t, d = material.t[which], material.result.displacement_mm[which]
    s = material.result.displacement_std_mm[which]
    for axes, middle in ((upper, d), (lower, np.zeros_like(d))):
        band = envelope(t, middle - BAND * s, middle + BAND * s, 3000)
        axes.fill_between(band.t, band.low, band.high, color=Colour.SKY, alpha=0.55, linewidth=0, label="±1.96 σ")
        draw_line(axes, envelope(t, middle, middle, 3000), Colour.BLUE, "displacement", linewidth=1.2)
        _shade(axes, material)
    reference = _reference_within(material, which)
    if reference is not None:
        for axes, value in ((upper, reference[1]), (lower, reference[1] - np.interp(reference[0], t, d))):
            axes.plot(reference[0], value, color=Colour.VERMILLION, linestyle=(0, (4, 2)), label="reference")
    for measured, colour in zip(
        material.measured, (Colour.BLACK, Colour.GREEN, Colour.PURPLE, Colour.ORANGE), strict=False
    ):
        _measurements((upper, lower), material, measured, (which, colour))
    # Nearly all of the band and all lines but a few points, so that one gap hides nothing else.
    lines = [np.abs(np.asarray(line.get_ydata(), dtype=np.float64)) for line in lower.lines]
    finite = [line[np.isfinite(line)] for line in lines]
    reach = [float(np.quantile(line, 0.98)) for line in finite if len(line)]
    limit = 1.5 * max(*reach, float(np.quantile(BAND * s, 0.9)), 1e-9)
    lower.set_ylim(-limit, limit)
    upper.set_xlim(t[0], t[-1])
    _finish(upper, material, "displacement (mm)")
    upper.set_xlabel("")
    lower.set_xlabel(material.clock.label)
    lower.set_ylabel("minus\ndisplacement (mm)")
    figure.align_ylabels()
    return picture(figure)


def _reference_within(material: Material, which: slice) -> tuple[Floats, Floats] | None:
    """Times and values (mm) of the reference, as it is drawn, within rows `which`; None where it has none there."""
    if material.reference is None:
        return None
    cut = _between(material.reference.time_ns, material, which)
    if cut.stop <= cut.start:
        return None
    value = material.reference.value[cut] + material.reference_moved_mm
    return material.clock.at(material.reference.time_ns[cut]), value


def _measurements(both: "tuple[Axes, Axes]", material: Material, measured: Measured, drawn: tuple[slice, str]) -> None:
    which, colour = drawn
    cut = _between(measured.time_ns, material, which)
    t, value = material.clock.at(measured.time_ns[cut]), measured.value_mm[cut]
    fused = np.interp(t, material.t[which], material.result.displacement_mm[which])
    options: dict[str, Any] = {"color": colour, "elinewidth": 0.7, "markersize": 3.0}
    if len(t) > MAX_CLEAR:
        # A fast sensor's points would hide the lines: small and pale, behind them.
        options |= {"elinewidth": 0.5, "markersize": 1.2, "alpha": 0.3, "zorder": 1.5}
    for axes, shown in zip(both, (value, value - fused), strict=True):
        label = f"{measured.name} ±1.96 σ"
        axes.errorbar(t, shown, BAND * measured.std_mm[cut], fmt="o", label=label, **options)


def _between(time_ns: Nanoseconds, material: Material, which: slice) -> slice:
    """The stamps (n,) that lie within rows `which` of the result."""
    rows = material.result.estimate.time_ns
    return inside(time_ns, int(rows[which.start]), int(rows[which.stop - 1]))


def spectra(material: Material, modes: Sequence[Mode]) -> Picture:
    """Amplitude densities of result, reference and the sensors alone over the first natural frequencies, and below how
    coherent each sensor is with the acceleration.
    """
    coherent = [(one, found) for one in material.measured if (found := _coherence(material, one)) is not None]
    figure = sheet(3.4 if not coherent else 4.8)
    grid = figure.subplots(
        1 + bool(coherent), 1, sharex=True, squeeze=False, height_ratios=(2.2, 1)[: 1 + bool(coherent)]
    )
    axes, nyquist_hz = grid[0, 0], 0.5 / step_of(material.result.estimate.time_ns)
    limit_hz = min(MODES_SHOWN * modes[-1].frequency_hz, nyquist_hz) if modes else nyquist_hz
    _densities(axes, material, limit_hz)
    for mode in modes:
        over = axes.get_xaxis_transform()
        axes.axvline(mode.frequency_hz, color=Colour.BLACK, linewidth=0.6, linestyle=":")
        axes.text(mode.frequency_hz, 0.99, f" {mode.frequency_hz:.3g} Hz", transform=over, fontsize=7.5, va="top")
    axes.set_xlim(0.0, limit_hz)
    axes.set_ylabel("amplitude density (mm/√Hz)")
    legend(axes, 4)
    if coherent:
        _coherences(grid[1, 0], coherent)
    grid[-1, 0].set_xlabel("frequency (Hz)")
    figure.align_ylabels()
    return picture(figure)


def _densities(axes: "Axes", material: Material, limit_hz: float) -> None:
    result, alone = material.result, (Colour.GREY, Colour.GREEN, Colour.PURPLE, Colour.ORANGE)
    for number, (measured, colour) in enumerate(zip(material.measured, alone, strict=False)):
        found = density(measured.time_ns, measured.value_mm)
        if found is not None:
            axes.semilogy(found[0], np.sqrt(found[1]), color=colour, label=f"{measured.name} alone")
        if number == 0:
            label = f"alias-free band of the {measured.name}, to {0.5 * measured.rate_hz:.3g} Hz"
            axes.axvspan(
                0.0, min(0.5 * measured.rate_hz, limit_hz), color=Colour.SKY, alpha=0.13, linewidth=0, label=label
            )
    reference = material.reference
    found = None if reference is None else density(reference.time_ns, reference.value)
    if found is not None:
        axes.semilogy(found[0], np.sqrt(found[1]), color=Colour.VERMILLION, linewidth=1.8, alpha=0.8, label="reference")
    found = density(result.estimate.time_ns, result.displacement_mm)
    if found is not None:
        root = np.sqrt(found[1])
        axes.semilogy(found[0], root, color=Colour.BLUE, linewidth=1.2, label="displacement")
        # A simulated truth has no noise floor and would squeeze everything else.
        shown = root[found[0] <= limit_hz]
        axes.set_ylim(max(0.3 * float(shown.min()), 1e-8 * float(shown.max()), 1e-15))


def _coherences(axes: "Axes", coherent: Sequence[tuple[Measured, tuple[Floats, Floats, float]]]) -> None:
    for (measured, (frequency, share, chance)), colour in zip(
        coherent, (Colour.GREY, Colour.GREEN, Colour.PURPLE, Colour.ORANGE), strict=False
    ):
        label = f"{measured.name} and acceleration" if len(coherent) > 1 else None
        axes.plot(frequency, share, color=colour, linewidth=1.2, label=label)
        axes.axhline(chance, color=Colour.BLACK, linewidth=0.7, linestyle="--")
    axes.set_ylim(0.0, 1.05)
    axes.set_ylabel("coherence")
    if len(coherent) > 1:
        legend(axes, 4)


def _coherence(material: Material, measured: Measured) -> tuple[Floats, Floats, float] | None:
    """Frequencies (Hz) up to the sensor's Nyquist frequency, coherence of its measurements with the acceleration, and
    what unrelated records stay below in 95 % of the frequencies; None for short records and without an acceleration.
    """
    from matplotlib import mlab

    felt, known = material.acceleration, np.isfinite(measured.value_mm)
    if felt is None or np.count_nonzero(known) < MIN_VALUES:
        return None
    heard = np.isfinite(felt.value)
    origin, step = int(measured.time_ns[0]), step_of(felt.time_ns)
    even = np.arange(0.0, (int(measured.time_ns[-1]) - origin) / NANOSECONDS, step)
    segment = int(min(SEGMENT_S / step, len(even) / SEGMENTS))
    if segment < MIN_VALUES:
        return None
    seen = np.interp(even, seconds(measured.time_ns[known], origin), measured.value_mm[known])
    moved = np.interp(even, seconds(felt.time_ns[heard], origin), felt.value[heard])
    with np.errstate(invalid="ignore", divide="ignore"):
        # Nothing moves: no share is defined.
        window, overlap = hann(segment), segment // 2
        found = mlab.cohere(seen, moved, segment, 1.0 / step, "linear", window, overlap)
    share, frequency = (np.asarray(one, dtype=np.float64) for one in found)
    # Half overlapping Hann windows are worth about as many as fit side by side.
    chance = 1.0 - 0.05 ** (1.0 / (len(even) / segment - 1.0))
    usable = (frequency > 0.0) & (frequency < 0.5 * measured.rate_hz) & np.isfinite(share)
    return frequency[usable], share[usable], chance


def natural_frequencies(material: Material) -> tuple[Mode, ...]:
    """The first modes of the displacement; none where the record is too short for them."""
    rows = material.result.estimate
    try:
        return spectrum(TimeSeries(rows.time_ns, rows.displacement_m)).modes
    except DataError:
        return ()


def density(time_ns: Nanoseconds, value: Floats) -> tuple[Floats, Floats] | None:
    """One-sided spectral density (mm²/Hz) at frequencies (Hz) by Welch's method; None below 64 values.

    Hann windows of an eighth of the record, half overlapping; irregular stamps are brought to an even grid before.
    """
    known = np.isfinite(value)
    if np.count_nonzero(known) < MIN_VALUES:
        return None
    t, value = seconds(time_ns[known], int(time_ns[0])), value[known]
    step = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], step)
    if len(even) < MIN_VALUES:
        return None
    segment = min(max(len(even) // SEGMENTS * 2, MIN_VALUES), MAX_SEGMENT, len(even))
    frequency, power = welch(np.interp(even, t, value), 1.0 / step, segment)
    return logarithmic_means(frequency[1:], np.maximum(power[1:], 1e-300))


def innovations(material: Material) -> Picture:
    """Measured minus predicted displacement over time, and its distribution in units of what was expected.

    A row for each sensor: what is expected of one is not what is expected of the other.
    """
    found = innovations_of(material)
    figure = sheet(3.0 if len(found) == 1 else 0.6 + 2.0 * len(found))
    grid = figure.subplots(len(found), 2, width_ratios=(2.6, 1), sharex="col", squeeze=False)
    for (left, right), (name, own) in zip(grid, found, strict=True):
        _met(left, material, own)
        left.set_xlim(material.t[0], material.t[-1])
        left.set_ylabel("measured − predicted (mm)" if len(found) == 1 else f"{name}:\nmeasured − predicted (mm)")
        _distribution(right, normalised_innovation(own))
    for axes in grid[:-1].ravel():
        axes.set_xlabel("")
    figure.align_ylabels(grid[:, 0])
    return picture(figure)


def innovations_of(material: Material) -> list[tuple[str, Innovation]]:
    """The innovations of each sensor with its name, of several those among the result's rows; none without any."""
    whole, sensors, rows = material.result.innovation, material.measured, material.result.estimate.time_ns
    if len(sensors) < 2:
        return [(sensors[0].name if sensors else "", whole)]
    whole = part(whole, inside(whole.time_ns, int(rows[0]), int(rows[-1])))
    known = np.array([np.isin(whole.time_ns, sensor.time_ns) for sensor in sensors])
    # A camera's clock that runs is corrected in what was fused alone: its stamps are nobody's.
    share = [np.mean(np.isin(sensor.time_ns, whole.time_ns)) for sensor in sensors]
    number = np.where(known.any(axis=0), known.argmax(axis=0), int(np.argmin(share)))
    each = [(sensor.name, part(whole, number == k)) for k, sensor in enumerate(sensors)]
    return [(name, own) for name, own in each if len(own.time_ns)]


def _met(axes: "Axes", material: Material, found: Innovation) -> None:
    """One sensor's innovations over time between what was expected of them."""
    t, value, std = material.clock.at(found.time_ns), 1e3 * found.value_m, 1e3 * np.sqrt(found.variance_m2)
    drawn = envelope(t, std, std)
    axes.plot(drawn.t, 2 * drawn.high, color=Colour.BLUE, linewidth=0.9, label="±2 σ expected")
    axes.plot(drawn.t, -2 * drawn.high, color=Colour.BLUE, linewidth=0.9)
    rejected = found.verdict == REJECTED
    usual = max(float(np.median(std)), 1e-9)
    reach = float(np.quantile(np.abs(value[~rejected]), 0.95)) if not rejected.all() else 0.0
    limit = max(CLIPPED_STD * usual, 1.05 * reach)
    beyond = int(np.count_nonzero(np.abs(value) > limit))
    value = np.clip(value, -0.97 * limit, 0.97 * limit)
    draw_points(axes, t[~rejected], value[~rejected], marker=".", markersize=2.2, color=Colour.GREY, label="innovation")
    if rejected.any():
        draw_points(
            axes, t[rejected], value[rejected], marker="x", markersize=5, color=Colour.VERMILLION, label="rejected"
        )
    if beyond:
        text = f"{beyond} beyond ±{limit / usual:.2g} median σ, drawn at the border"
        axes.text(0.995, 0.98, text, transform=axes.transAxes, ha="right", va="top", fontsize=8)
    axes.set_ylim(-limit, limit)
    _finish(axes, material, "measured − predicted (mm)")


def _distribution(axes: "Axes", normalised: Floats) -> None:
    grid = np.linspace(-5.0, 5.0, 201)
    if len(normalised):
        shown = np.clip(normalised, -5.0, 5.0)
        axes.hist(shown, bins=np.linspace(-5, 5, 41).tolist(), density=True, color=Colour.SKY, label="found")
    axes.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2 * np.pi), color=Colour.BLACK, label="expected")
    axes.set_xlabel("innovation / σ")
    axes.set_ylabel("probability density")
    legend(axes, 2)
