"""The page: small pieces of HTML, every text of the data escaped, every picture inside."""

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from urllib.parse import quote

from midspan.notices import Notice
from midspan.report.drawing import Picture
from midspan.writing import WRITTEN_BY

# In this order one script.
SCRIPTS = ("columns.js", "drawing.js", "history.js")


def _own(name: str) -> str:
    """A file of this module's folder."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def _policy(style: str, script: str) -> str:
    """What a browser may load and run for the page: its own style and script and the pictures inside, no network."""
    style_hash, script_hash = (
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in (style, script)
    )
    return (
        f"default-src 'none'; img-src data:; style-src {style_hash}; script-src {script_hash}; base-uri 'none'; "
        "form-action 'none'"
    )


def document(title: str, body: Iterable[str]) -> str:
    """A whole page with its style and its one script inside."""
    style = f"\n{_own('style.css')}"
    script = f'\n"use strict";\n(() => {{\n{"".join(_own(name) for name in SCRIPTS)}}})();\n'
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_policy(style, script)}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta name="generator" content="{WRITTEN_BY}">',
            f"<title>{escape(title)}</title>",
            f"<style>{style}</style></head>",
            "<body><main>",
            *body,
            "</main>",
            f"<script>{script}</script>",
            "</body></html>\n",
        ]
    )


def heading(title: str, lines: Iterable[str]) -> str:
    """The page's title and the lines below it."""
    return f"<header><h1>{escape(title)}</h1>{''.join(f'<div class=meta>{escape(x)}</div>' for x in lines)}</header>"


def section(identity: str, title: str, *pieces: str, closed: bool = False) -> str:
    """A section with its heading; `pieces` are HTML already. closed: it opens on a click."""
    heading, inner = f"<h2>{escape(title)}</h2>", "\n".join(pieces)
    if closed:
        heading, inner = "", f"<details><summary>{heading}</summary>\n{inner}\n</details>"
    return f'<section id="{escape(identity)}">{heading}{inner}\n</section>'


def contents(pieces: Iterable[str]) -> str:
    """Links to the sections among the pieces."""
    found = re.findall(r'<section id="([^"]*)"><h2>(.*?)</h2>', "".join(pieces))
    links = "".join(f'<a href="#{identity}">{title}</a>' for identity, title in found)
    return f'<nav aria-label="Contents">{links}</nav>'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f"<p{_kind(kind)}>{escape(text)}</p>"


def bullets(lines: Iterable[str], kind: str) -> str:
    """A list of plain texts; notices with their severity as class, and their code."""
    found = ""
    for line in lines:
        if isinstance(line, Notice):
            found += f"<li class={line.severity}>{escape(line)} <code>{line.code}</code></li>"
        else:
            found += f"<li>{escape(line)}</li>"
    return f"<ul{_kind(kind)}>{found}</ul>"


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
    # Smaller than base64, and characters that end an address or an attribute are escaped.
    data = quote(drawn.data, safe=" /:;,.=+-*()|!?'{}").replace("://", "%3A//")
    more = "".join(f' {name}="{escape(value)}"' for name, value in (attributes or {}).items())
    return (
        f'<figure{more}><div class=wide><img alt="{escape(title)}" src="data:{drawn.media_type},{data}"></div>'
        f"<figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption></figure>"
    )


def collapsible(summary: str, piece: str, kind: str = "") -> str:
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
