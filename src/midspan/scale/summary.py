"""The summary of a campaign, one row a recording, as CSV, Parquet and a page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from midspan.scale.work import Outcome
from midspan.writing import write_whole

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("recording", "exit_code", "rows", "rmse_mm", "warnings", "seconds", "message")
STYLE = """
:root { color-scheme: light dark }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem }
div { overflow-x: auto }
table { border-collapse: collapse; width: 100% }
th, td { border-bottom: 1px solid #8886; padding: .3rem .6rem; text-align: left; vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums }
td:last-child { min-width: 24rem }
tr.bad td:first-child { border-left: 4px solid #c33 }
@media (max-width: 45rem) {
thead { display: none }
table, tbody, tr, td, td.n { display: block; text-align: left }
tr { border-bottom: 1px solid #8886; padding: .5rem 0 }
td { border: 0; padding: .1rem .6rem }
td:empty { display: none }
td:first-child { font-weight: bold; overflow-wrap: anywhere }
td:last-child { min-width: 0; overflow-wrap: anywhere }
td:not(:first-child, :last-child)::before { content: attr(data-name) ": " }
}
"""
# How the page calls the columns.
SHOWN = ("recording", "exit code", "rows", "RMSE, mm", "warnings", "seconds", "message")
NUMBERS = ("exit code", "rows", "RMSE, mm", "seconds")


def frame_of(outcomes: Sequence[Outcome]) -> "pd.DataFrame":
    """One row a recording; warnings as codes with their numbers, `exposure 1; tilt 2`."""
    import pandas as pd

    rows = [
        (
            outcome.recording,
            outcome.exit_code,
            outcome.rows,
            outcome.rmse_mm,
            "; ".join(f"{code} {count}" for code, count in outcome.warnings.items()),
            round(outcome.seconds, 3),
            outcome.message,
        )
        for outcome in outcomes
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"rmse_mm": "float64"})


def write_summary(output: Path, outcomes: Sequence[Outcome]) -> None:
    """Write summary.csv, summary.parquet and summary.html to a folder."""
    import io

    frame = frame_of(outcomes)
    write_whole(output / "summary.csv", frame.to_csv(index=False).encode())
    buffer = io.BytesIO()
    frame.to_parquet(buffer, index=False)
    write_whole(output / "summary.parquet", buffer.getvalue())
    write_whole(output / "summary.html", _page(outcomes).encode())


def _page(outcomes: Sequence[Outcome]) -> str:
    failed = sum(outcome.exit_code != 0 for outcome in outcomes)
    head = "".join(f"<th>{name}</th>" for name in SHOWN)
    body = "".join(
        _row(outcome) for outcome in sorted(outcomes, key=lambda outcome: (outcome.exit_code == 0, outcome.recording))
    )
    text = f"{len(outcomes)} recordings, {failed} of them failed or refused; these stand first."
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>Campaign</title><style>{STYLE}</style><h1>Campaign</h1><p>{text}</p>"
        '<div tabindex="0" role="region" aria-label="Recordings">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></html>"
    )


def _row(outcome: Outcome) -> str:
    rmse = "" if outcome.rmse_mm is None else f"{outcome.rmse_mm:.4g}"
    codes = "; ".join(f"{code} {count}" for code, count in outcome.warnings.items())
    values = (
        outcome.recording,
        str(outcome.exit_code),
        str(outcome.rows),
        rmse,
        codes,
        f"{outcome.seconds:.1f}",
        outcome.message,
    )
    cells = (
        f'<td data-name="{name}"{" class=n" if name in NUMBERS else ""}>{escape(value)}</td>'
        for name, value in zip(SHOWN, values, strict=True)
    )
    return f'<tr class="{"bad" if outcome.exit_code else "good"}">{"".join(cells)}</tr>'
