"""A hook of the documentation's site: the examples as a gallery, and links out of docs/ as plain names."""

import ast
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]


def on_files(files: Files, config: Any) -> Files:
    """Add the page of the examples."""
    files.append(File.generated(config, "examples.md", content=gallery()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to files outside docs/ lead nowhere in a site: their names stay."""
    return re.sub(r"\[([^\]]+)\]\((?:\.\./)+[^)]*\)", r"`\1`", markdown)


def on_post_page(output: str, **_: Any) -> str:
    """Without the one script that would be loaded from elsewhere: the search needs a server then, nothing else does."""
    return re.sub(r'<script src="?https:[^>]*></script>', "", output)


def gallery() -> str:
    """A page with each example: what it shows, and its lines."""
    found = ["# Examples", "", "Each runs as it is: `python examples/NAME`.", ""]
    for path in sorted((ROOT / "examples").glob("[0-9]*.py")):
        text = path.read_text(encoding="utf-8")
        summary = (ast.get_docstring(ast.parse(text)) or "").strip()
        found += [f"## {path.stem}", "", summary, "", "```python", text.rstrip(), "```", ""]
    return "\n".join(found)
