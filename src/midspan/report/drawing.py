"""How the report's figures look, and how they become pictures inside the page."""

import base64
import io
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan.records import Floats
from midspan.report.thinning import Envelope
from midspan.writing import WRITTEN_BY, write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Colour(StrEnum):
    """Okabe and Ito's colours, which the colour-blind can tell apart."""

    BLUE = "#0072B2"
    VERMILLION = "#D55E00"
    GREEN = "#009E73"
    SKY = "#56B4E9"
    ORANGE = "#E69F00"
    PURPLE = "#CC79A7"
    GREY = "#7A7A7A"
    BLACK = "#222222"


WIDTH_IN = 9.6
# Lines of a drawing that grows beyond this are kept as dots instead.
MAX_SVG = 200_000
DOTS_PER_INCH = 150
# Of photographs, 0 to 100: artefacts stay below what a screen shows.
JPEG_QUALITY = 85
# Colours of a drawing and what they are on a dark page.
DARK = {
    Colour.BLACK: "#e0e4ea",
    "#444444": "#a9b2bd",
    "#888888": "#66707c",
    "#e3e3e3": "#323a44",
    Colour.BLUE: "#63bdf0",
    Colour.VERMILLION: "#ff8a3d",
    Colour.GREEN: "#35c79c",
    Colour.GREY: "#9aa3ad",
}
_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "font.family": ["DejaVu Sans"],
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": "#888888",
    "axes.labelcolor": Colour.BLACK,
    "axes.titlecolor": Colour.BLACK,
    "text.color": Colour.BLACK,
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
    """An empty figure across the page, whose layout `picture` and `saved` make."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in))


def picture(figure: "Figure") -> Picture:
    """The figure as lines (SVG) that follow the page's colour scheme, transparent; photographs lie inside."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    FigureCanvasSVG(figure)
    # A figure that has a layout engine is drawn twice by savefig, the first time for the layout alone.
    ConstrainedLayoutEngine().execute(figure)
    drawn = _drawing(figure)
    if len(drawn) > MAX_SVG:
        for axes in figure.axes:
            for artist in (*axes.lines, *axes.collections):
                artist.set_rasterized(True)
        drawn = _drawing(figure)
    return Picture("image/svg+xml", drawn.encode())


def _drawing(figure: "Figure") -> str:
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None}, dpi=DOTS_PER_INCH)
    text = file.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r' d="([^"]*)"', lambda found: f' d="{_shorter(found[1])}"', text)
    text = re.sub(r"data:image/png;base64,([^\"]*)", lambda found: _smaller(found[1]), text)
    for light in DARK:
        text = text.replace(f": {light.lower()}", f": var(--{_variable(light)})")
    return text.replace("<defs>", f"<style>{_COLOURS}</style>\n <defs>", 1)


def _variable(colour: str) -> str:
    return f"c{colour[1:].lower()}"


def _set(colours: Iterable[tuple[str, str]]) -> str:
    return f":root{{{''.join(f'--{_variable(name)}:{value};' for name, value in colours)}}}"


_COLOURS = (
    f"{_set((light, light) for light in DARK)}@media screen and (prefers-color-scheme:dark){{{_set(DARK.items())}}}"
)


def _shorter(path: str) -> str:
    """A path with two digits after the point, and no command written twice."""
    found, last = list[str](), ""
    for line in re.sub(r"(\.\d\d)\d+", r"\1", path).split("\n"):
        command, *rest = line.split() or [""]
        # What follows a move is a line.
        again = (command == last and command in "LQC") or (command, last) == ("L", "M")
        found.append(" ".join(rest) if again else f"{command}{' '.join(rest)}")
        last = last if again else command
    return " ".join(found)


def _smaller(data: str) -> str:
    """The address of an embedded picture: a grey one without gaps, a photograph, as JPEG."""
    from PIL import Image

    with Image.open(io.BytesIO(base64.b64decode(data))) as found:
        red, green, blue, alpha = np.moveaxis(np.asarray(found.convert("RGBA")), 2, 0)
        if alpha.min() < 255 or not (np.array_equal(red, green) and np.array_equal(red, blue)):
            return f"data:image/png;base64,{data}"
        file = io.BytesIO()
        Image.fromarray(red).save(file, "JPEG", quality=JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def write_picture(figure: "Figure", path: Path, dpi: int, **options: Any) -> Path:
    """Write a figure as a picture file, by its suffix, that says what wrote it."""
    kind, file = path.suffix.lower().lstrip("."), io.BytesIO()
    says: dict[str, Any] = {"metadata": {"Software" if kind == "png" else "Creator": WRITTEN_BY}}
    if kind in ("jpg", "jpeg"):
        says = {"pil_kwargs": {"comment": WRITTEN_BY}}
    figure.set_layout_engine("constrained")
    figure.savefig(file, format=kind, dpi=dpi, **says, **options)
    write_whole(path, file.getvalue())
    return path


def legend(axes: "Axes", columns: int) -> None:
    """The legend in a row over the axes."""
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, borderaxespad=0.2)


def draw_line(axes: "Axes", drawn: Envelope, colour: str, label: str, **options: Any) -> None:
    """A series as a line, or as the area between its extremes where it was thinned."""
    x, y = drawn.line()
    axes.plot(x, y, color=colour, label=label, **({"linewidth": 0.9} | options))


def draw_points(axes: "Axes", x: Floats, y: Floats, **options: Any) -> None:
    """Small marks, as dots inside the drawing where there are many."""
    axes.plot(x, y, linestyle="none", rasterized=len(x) > 800, **options)
