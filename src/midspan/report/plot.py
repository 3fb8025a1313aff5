"""A result as a picture: the time history with its band, on axes or in a notebook."""

import base64
import io
from html import escape
from typing import TYPE_CHECKING

from midspan.checks import instance
from midspan.notebook import table
from midspan.notices import worst_first
from midspan.recording.result import Result
from midspan.report.thinning import envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE_INCHES = (9.0, 3.0)
# In a notebook.
MAX_WARNINGS = 3


def plot(result: Result, axes: "Axes | None" = None) -> "Figure":
    """Draw the time history with its ±1.96 standard deviations, see `Result.plot`."""
    from matplotlib import axes as kinds
    from matplotlib import pyplot

    if axes is None:
        figure, axes = pyplot.subplots(figsize=FIGURE_INCHES, layout="constrained")
        if "inline" in pyplot.get_backend():
            # A notebook shows the figure that a cell returns; it would show one that is still open once more.
            pyplot.close(figure)
    instance("axes", axes, kinds.Axes, "axes of matplotlib", "Leave axes out for a figure of its own.")
    for one in (result,) if result.across is None else (result, result.across):
        time_s, value, half = one.time_s, one.displacement_mm, 1.96 * one.displacement_std_mm
        band = envelope(time_s, value - half, value + half)
        axes.fill_between(band.t, band.low, band.high, alpha=0.3, linewidth=0, label="±1.96 σ")
        label = "displacement" if result.across is None else f"displacement along {one.axis}"
        axes.plot(*envelope(time_s, value, value).line(), linewidth=0.9, label=label)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("displacement (mm)")
    # Over the axes, where nothing is drawn.
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2, frameon=False)
    axes.grid(alpha=0.3)
    return axes.get_figure(root=True)  # type: ignore[return-value]


def notebook_html(result: Result) -> str:
    """What a notebook shows: the verdict, the picture, the first figures and the worst warnings."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
    plot(result, figure.subplots())
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=96)
    data = base64.b64encode(picture.getvalue()).decode()
    rows = [("displacement", result.summary()), *result.calibration.summary()]
    listed = list[str](worst_first(result.warnings))
    if len(listed) > MAX_WARNINGS:
        listed[MAX_WARNINGS:] = [f"and {len(listed) - MAX_WARNINGS} more: see result.warnings or the report"]
    picture_html = f'<img src="data:image/png;base64,{data}"/>'
    return f"<p><b>{escape(result.verdict)}</b></p>{picture_html}{table(result.name, rows, listed)}"
