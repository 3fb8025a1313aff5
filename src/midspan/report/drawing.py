"""How the report's figures look, and how they become pictures inside the page."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from midspan.records import Floats
from midspan.signals.thinning import Envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which the colour-blind can tell apart.
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
SKY, ORANGE, PURPLE, GREY, BLACK = "#56B4E9", "#E69F00", "#CC79A7", "#7A7A7A", "#222222"

WIDTH_IN = 9.6
# A drawing in lines that grows beyond this is kept in dots instead.
MAX_SVG = 400_000
_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "font.family": ["DejaVu Sans"],
    "axes.edgecolor": "#888888",
    "axes.labelcolor": BLACK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 0.9,
    "path.simplify": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "midspan",
}


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as bytes with its media type."""

    media_type: str
    data: bytes


@contextmanager
def style() -> Iterator[None]:
    """The report's look for everything drawn inside; the user's own settings are back afterwards."""
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


def sheet(height_in: float = 3.0, width_in: float = WIDTH_IN) -> "Figure":
    """An empty figure across the page."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def picture(figure: "Figure", *, dots: bool = False) -> Picture:
    """The figure as lines (SVG), or as dots (PNG) where asked for or where lines would be larger."""
    if not dots:
        lines = saved(figure, "svg", metadata={"Date": None, "Creator": None})
        if len(lines) <= MAX_SVG:
            return Picture("image/svg+xml", lines)
    return Picture("image/png", saved(figure, "png", dpi=150, metadata={"Software": None}))


def saved(figure: "Figure", kind: str, **options: Any) -> bytes:
    """The figure as the bytes of a file of this kind."""
    file = io.BytesIO()
    figure.savefig(file, format=kind, **options)
    return file.getvalue()


def draw_line(axes: "Axes", drawn: Envelope, colour: str, label: str, **options: Any) -> None:
    """A series as a line, or as the area between its extremes where it was thinned."""
    x, y = drawn.line()
    axes.plot(x, y, color=colour, label=label, **({"linewidth": 0.9} | options))


def draw_points(axes: "Axes", x: Floats, y: Floats, **options: Any) -> None:
    """Small marks, as dots inside the drawing where there are many."""
    axes.plot(x, y, linestyle="none", rasterized=len(x) > 800, **options)
