"""The page of the papers' repeated experiments: a table for each paper and figures like the papers' own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from midspan.papers.claims import Curve, Row
from midspan.papers.published import PAPERS, Paper
from midspan.papers.table import Outcome
from midspan.report import page
from midspan.report.drawing import Colour, picture, sheet, style, write_picture
from midspan.writing import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHORT_HEADER = ("", "paper", "as printed, here", "our default", "holds")
SHORT = (
    "`--report page.html` has the variants (true scale factor, mean input, guarded), how many times less our default "
    "errs, claims, reasons and what is chosen here."
)
HEADER = ("", "paper", "as printed, here", "our default", "times less", "claim")
# Ours is blue in every figure; what the papers compare with has the colours after it.
OURS, OTHERS = (
    ("smoother", "ours"),
    (Colour.VERMILLION, Colour.GREEN, Colour.ORANGE, Colour.PURPLE, Colour.GREY, "#8C564B"),
)


def write_papers(outcomes: Sequence[Outcome], path: Path, command: str, late: Mapping[str, str] | None = None) -> Path:
    """Write the page to `path`: one HTML file, or Markdown whose figures go into images/ of its folder.

    late: by paper the time to a row, in words. Raises UsageError where it cannot be written.
    """
    with style():
        if path.suffix == ".md":
            write_whole(path, _markdown(outcomes, path, command, late or {}).encode())
        else:
            write_whole(path, _html(outcomes, command, late or {}).encode())
    return path


def _html(outcomes: Sequence[Outcome], command: str, late: Mapping[str, str]) -> str:
    body = []
    for paper in _repeated(outcomes):
        own = [one for one in outcomes if one.experiment.paper == paper.key]
        rows = [_cells(row) for one in own for row in one.rows]
        drawn = [
            page.figure(picture(_axes(curve)), f"{paper.key} {curve.figure}", f"{curve.y} over {curve.x}.")
            for one in own
            for curve in one.curves
        ]
        free = page.bullets([f"{name}: {text}" for name, text in _free(own)], "")
        chosen = page.collapsible("What the paper does not print, chosen here", free)
        live = [page.paragraph(f"Live: {late[paper.key]}.")] if paper.key in late else []
        text = (page.paragraph(paper.citation), *live, page.table(rows, HEADER), chosen)
        body.append(page.section(paper.key, paper.name, *text, *drawn))
    title = "The papers' experiments, repeated in simulation"
    return page.document(title, [page.heading(title, [_made(command)]), page.contents(body), *body])


def _axes(curve: Curve) -> "Figure":
    figure = sheet(2.6, 6.4)
    axes = figure.subplots()
    others = iter(OTHERS)
    for name, (x, y) in curve.lines.items():
        colour = Colour.BLUE if name.startswith(OURS) else next(others)
        axes.plot(x, y, marker="o" if curve.dots else "", markersize=3.5, color=colour, label=name)
    axes.set_xlabel(curve.x)
    axes.set_ylabel(curve.y)
    if curve.log:
        axes.set_yscale("log")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    return figure


def _markdown(outcomes: Sequence[Outcome], path: Path, command: str, late: Mapping[str, str]) -> str:
    """A row for each published figure, in few words; the page of HTML has the variants, claims and reasons in full."""
    (path.parent / "images").mkdir(exist_ok=True)
    lines = ["# The papers' tables and figures, repeated", "", f"{_made(command)} {SHORT}", ""]
    for paper in _repeated(outcomes):
        own = [one for one in outcomes if one.experiment.paper == paper.key]
        lines += [f"## {paper.key}: {paper.name}", ""]
        lines += [f"Live: {late[paper.key]}.", ""] if paper.key in late else []
        lines += [_line(SHORT_HEADER), _line(["---"] * len(SHORT_HEADER))]
        shown: list[Row] = []
        for row in (row for one in own for row in one.rows):
            if not (shown and is_variant(row, shown[-1])):
                shown.append(row)
        lines += [_line(brief_cells(row)) for row in shown]
        for one in own:
            for curve in one.curves:
                name = "".join(c for c in f"paper_{paper.key}_{curve.figure.lower()}" if c.isalnum() or c == "_")
                picture_file = path.parent / "images" / f"{name}.png"
                write_picture(_axes(curve), picture_file, 110)
                lines += ["", f"![{curve.figure}](images/{name}.png)"]
        lines.append("")
    return "\n".join(lines)


def is_variant(row: Row, shown: Row) -> bool:
    """Whether a row repeats the published figure of another one in another way."""
    return row.entry.paper == shown.entry.paper and row.entry.where.startswith(f"{shown.entry.where}, ")


def brief_cells(row: Row) -> tuple[str, ...]:
    """A row in few words."""
    cells = (f"{row.entry.where}: {row.entry.what}", row.entry.paper, row.printed, row.ours, row.brief)
    # Numbers of several cases stand close together.
    return tuple(cell.replace(" / ", "/") for cell in cells)


def _cells(row: Row) -> tuple[str, ...]:
    factor = row.compared.removesuffix(" times less")
    where, less = f"{row.entry.where}: {row.entry.what}", row.with_less_noise
    claim = f"{row.verdict.value}: {row.why}" + (f". With less noise: {less}" if less else "")
    return where, row.entry.paper, row.printed, row.ours, factor, claim


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def _repeated(outcomes: Sequence[Outcome]) -> list[Paper]:
    keys = {one.experiment.paper for one in outcomes}
    return [paper for paper in sorted(PAPERS, key=lambda paper: paper.key) if paper.key in keys]


def _free(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    return [(one.experiment.name, one.experiment.free) for one in outcomes if one.experiment.free]


def _made(command: str) -> str:
    return f"Made by `{command}`, in simulation with known truth; errors without their mean unless the row says else."
