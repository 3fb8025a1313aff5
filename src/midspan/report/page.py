"""The page: small pieces of HTML, every text of the data escaped, every picture inside."""

import base64
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path

from midspan.report.drawing import Picture
from midspan.writing import WRITTEN_BY


def _own(name: str) -> str:
    """A file of this module's folder."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def document(title: str, body: Iterable[str]) -> str:
    """A whole page with its style and its one script inside."""
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta name="generator" content="{WRITTEN_BY}">',
            f"<title>{escape(title)}</title>",
            f"<style>\n{_own('style.css')}</style></head>",
            "<body><main>",
            *body,
            "</main>",
            f"<script>\n{_own('history.js')}</script>",
            "</body></html>\n",
        ]
    )


def heading(title: str, lines: Iterable[str]) -> str:
    """The page's title and the lines below it."""
    return f"<header><h1>{escape(title)}</h1>{''.join(f'<div class=meta>{escape(x)}</div>' for x in lines)}</header>"


def section(identity: str, title: str, *pieces: str) -> str:
    """A section with its heading; `pieces` are HTML already."""
    return f'<section id="{escape(identity)}"><h2>{escape(title)}</h2>\n' + "\n".join(pieces) + "\n</section>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f"<p{_kind(kind)}>{escape(text)}</p>"


def bullets(lines: Iterable[str], kind: str) -> str:
    """A list of plain texts."""
    return f"<ul{_kind(kind)}>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>"


def cards(rows: Iterable[tuple[str, str, str]]) -> str:
    """Cards of label, value and a smaller line."""
    found = [
        f"<div class=card><div class=label>{escape(label)}</div><div class=value>{escape(value)}</div>"
        f"<div class=more>{escape(more)}</div></div>"
        for label, value, more in rows
    ]
    return f"<div class=cards>{''.join(found)}</div>"


def table(rows: Iterable[tuple[str, ...]], header: tuple[str, ...] = ()) -> str:
    """A table whose first column names the row; with a header it may be long and scrolls on the screen."""
    top = f"<thead><tr>{''.join(f'<th>{escape(x)}</th>' for x in header)}</tr></thead>" if header else ""
    lines = [
        f"<tr><th>{escape(row[0])}</th>{''.join(f'<td>{escape(value)}</td>' for value in row[1:])}</tr>" for row in rows
    ]
    body = f"<table>{top}<tbody>{''.join(lines)}</tbody></table>"
    return f"<div class=listed>{body}</div>" if header else body


def figure(drawn: Picture, title: str, caption: str, attributes: Mapping[str, str] | None = None) -> str:
    """A picture with its title and how to read it."""
    data = base64.b64encode(drawn.data).decode()
    more = "".join(f' {name}="{escape(value)}"' for name, value in (attributes or {}).items())
    return (
        f'<figure{more}><img alt="{escape(title)}" src="data:{drawn.media_type};base64,{data}">'
        f"<figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption></figure>"
    )


def folded(summary: str, piece: str, kind: str = "") -> str:
    """Something long, HTML already, that opens on a click."""
    return f"<details{_kind(kind)}><summary>{escape(summary)}</summary>{piece}</details>"


def verbatim(text: str) -> str:
    """A long text as it is."""
    return f"<pre>{escape(text)}</pre>"


def footer(lines: Iterable[str]) -> str:
    """The page's last lines."""
    return f"<footer>{''.join(paragraph(line) for line in lines)}</footer>"


def _kind(kind: str) -> str:
    return f' class="{escape(kind)}"' if kind else ""
