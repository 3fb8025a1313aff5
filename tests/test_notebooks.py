"""The notebook of the examples runs cell by cell as it is, and is kept without outputs."""

import ast
import json
from pathlib import Path

import pytest

from brief import shorten
from repeats import slow

# The natural frequencies of the footbridge show in half a minute.
BRIEF_S = 30.0
NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples").glob("*.ipynb"))


def cells(path: Path) -> list[dict]:  # type: ignore[type-arg]
    return json.loads(path.read_text(encoding="utf-8"))["cells"]  # type: ignore[no-any-return]


def shown(source: str, names: dict[str, object]) -> object:
    """Run a cell; what its last line is, as a notebook would show it."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)  # type: ignore[attr-defined]


def test_there_is_a_notebook() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_outputs(path: Path) -> None:
    # 20 kB of text: pictures belong into the run.
    assert path.stat().st_size < 20_000
    found = cells(path)
    assert len({cell["id"] for cell in found}) == len(found)
    for cell in found:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.mark.parametrize("brief", [True, *slow(False)])
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_every_cell_runs_and_what_it_shows_has_a_form_for_notebooks(
    path: Path, brief: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if brief:
        shorten(monkeypatch, BRIEF_S)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names: dict[str, object] = {"__name__": "__main__"}
    values = [shown("".join(cell["source"]), names) for cell in cells(path) if cell["cell_type"] == "code"]
    pages = [page for value in values if (page := getattr(value, "_repr_html_", lambda: None)())]
    assert len(pages) >= 4
    assert any("mm/px" in page for page in pages)
    assert "Hz, damping" in capsys.readouterr().out
    assert (next(tmp_path.glob("midspan-*")) / "site" / "report.html").is_file()
