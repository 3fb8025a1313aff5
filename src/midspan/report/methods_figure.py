"""The displacement by several methods in one picture: the whole record, its liveliest part, and what each is off by."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from midspan.errors import UntrustedError
from midspan.evaluate.methods import MethodRun
from midspan.evaluate.result_file import of_result
from midspan.recording.result import Result
from midspan.records import Floats, TimeSeries
from midspan.report.drawing import Colour, sheet, style, write_picture
from midspan.report.thinning import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# One for each row of the table: the methods, then the papers' as printed.
COLOURS = (
    Colour.BLUE,
    Colour.VERMILLION,
    Colour.GREEN,
    Colour.ORANGE,
    Colour.PURPLE,
    Colour.SKY,
    Colour.GREY,
    "#8C564B",
    "#BCBD22",
)
# Length of the part that is drawn larger, s: a few cycles of a structure of 1 Hz.
CLOSE_S = 5.0


def draw_methods(runs: Sequence[MethodRun], reference: TimeSeries | None, path: Path) -> Path:
    """Write the picture; without a reference the methods are compared with the first of them."""
    first = next((run.result for run in runs if run.result is not None), None)
    if first is None:
        raise UntrustedError(f"Every method was refused. {runs[0].refused}")
    with style():
        figure = sheet(7.2)
        whole, close, apart = figure.subplots(3, 1)
        middle_s = _liveliest(first)
        for axes, span in ((whole, (-np.inf, np.inf)), (close, (middle_s - CLOSE_S / 2, middle_s + CLOSE_S / 2))):
            if reference is not None:
                _line(axes, (reference.time_ns / 1e9, 1e3 * reference.value), span, (Colour.BLACK, "reference", 1.6))
            for colour, run in zip(COLOURS, runs, strict=False):
                if run.result is not None:
                    _line(axes, (run.result.time_s, run.result.displacement_mm), span, (colour, run.name, 0.8))
            axes.set_ylabel("displacement (mm)")
        whole.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
        _differences(apart, runs, reference)
        apart.set_xlabel("time (s)")
        figure.align_ylabels()
        return write_picture(figure, path, 130)


def _line(axes: "Axes", series: tuple[Floats, Floats], span: tuple[float, float], look: tuple[str, str, float]) -> None:
    """A series (time in s, mm) within a span as a line of a colour, label and width; long ones as their extremes."""
    (time_s, value), (colour, label, width) = series, look
    inside = (time_s >= span[0]) & (time_s <= span[1])
    drawn = envelope(time_s[inside], value[inside], value[inside]).line()
    axes.plot(*drawn, color=colour, label=label, linewidth=width)
    axes.margins(x=0.005)


def _differences(axes: "Axes", runs: Sequence[MethodRun], reference: TimeSeries | None) -> None:
    """What each method is off by, from the reference or from the first method."""
    everything = (-np.inf, np.inf)
    first = next(run for run in runs if run.result is not None)
    assert first.result is not None
    for colour, run in zip(COLOURS, runs, strict=False):
        if run.comparison is not None:
            series = run.comparison.time_ns / 1e9, run.comparison.error_mm
        elif run.result is not None and run is not first:
            time_s = run.result.time_s
            other = np.interp(time_s, first.result.time_s, first.result.displacement_mm)
            series = time_s, run.result.displacement_mm - other
        else:
            continue
        _line(axes, series, everything, (colour, run.name, 0.8))
    axes.set_ylabel("error (mm)" if reference is not None else f"less {first.name} (mm)")


def _liveliest(result: Result) -> float:
    """Where the displacement moves most, s: the middle of the part that is drawn larger."""
    series = of_result(result).series
    value = series.value - np.mean(series.value)
    count = max(1, round(CLOSE_S * (len(value) - 1) / float(result.time_s[-1] - result.time_s[0])))
    power = np.convolve(value**2, np.ones(min(count, len(value))), mode="same")
    return float(
        np.clip(result.time_s[np.argmax(power)], result.time_s[0] + CLOSE_S / 2, result.time_s[-1] - CLOSE_S / 2)
    )
