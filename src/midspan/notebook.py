"""What a notebook shows of a record: a table of names and values."""

import html
from collections.abc import Iterable


def table(title: str, rows: Iterable[tuple[str, str]], notes: Iterable[str] = ()) -> str:
    """HTML of a title, names with their values, and notes below them."""
    cells = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    lines = "".join(f"<li>{html.escape(line)}</li>" for line in notes)
    below = f"<ul>{lines}</ul>" if lines else ""
    return f"<table><caption>{html.escape(title)}</caption><tbody>{cells}</tbody></table>{below}"
