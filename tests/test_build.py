"""What pip does with the sources: the page is built with the package, and a build without it is explained."""

import asyncio
import importlib.util
import shutil
import subprocess
from pathlib import Path

import httpx
import pytest

from midspan.serve import application

ROOT = Path(__file__).parents[1]


@pytest.fixture
def backend():
    spec = importlib.util.spec_from_file_location("build_midspan", ROOT / "tools/build_midspan.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_wheel_has_the_page_that_is_built_with_it(backend, monkeypatch, tmp_path):
    page, called = tmp_path / "index.html", []
    monkeypatch.setattr(backend, "PAGE", page)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert backend.NODE in backend.get_requires_for_build_wheel()

    def run(command, **how):
        called.append(command)
        page.write_text("built")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(backend.maturin, "build_wheel", lambda *_: page.read_text())
    assert backend.build_wheel("dist") == "built"
    assert called == [["sh", "tools/page.sh", "build"]]
    # A source distribution has it, and needs no Node.
    assert backend.build_wheel("dist") == "built"
    assert len(called) == 1
    assert backend.NODE not in backend.get_requires_for_build_wheel()


def test_without_npm_the_package_is_built_and_says_that_it_has_no_page(backend, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(backend, "PAGE", tmp_path / "index.html")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: (_ for _ in ()).throw(OSError("no sh")))
    monkeypatch.setattr(backend.maturin, "build_wheel", lambda *_: "midspan.whl")
    assert backend.build_wheel("dist") == "midspan.whl"
    assert "the page could not be built" in capsys.readouterr().err


def test_a_server_without_the_page_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setattr(application, "PAGE", tmp_path / "page")
    transport = httpx.ASGITransport(application.page_over(None, []))

    async def asked():
        async with httpx.AsyncClient(transport=transport, base_url="http://midspan") as client:
            return await client.get("/")

    answer = asyncio.run(asked())
    assert answer.status_code == 503
    assert "make page" in answer.text
