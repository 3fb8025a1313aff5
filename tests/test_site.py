"""The documentation as a site: every page is in it, and no link or heading that is linked to is missing."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the built site, whose build fails on any warning."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, timeout=300,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_and_example_is_in_the_site(site):
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT / "docs")).with_suffix(".html").exists()
    gallery = (site / "examples.html").read_text(encoding="utf-8")
    for example in (ROOT / "examples").glob("[0-9]*.py"):
        assert example.stem in gallery


def test_the_site_works_without_a_network(site):
    """Nothing that a page loads on its own comes from elsewhere: links may lead there."""
    loaded = re.compile(r"<(?:script|link|img)[^>]+(?:src|href)=\"?(https?:[^\" >]+)")
    for page in site.rglob("*.html"):
        found = [at for at in loaded.findall(page.read_text(encoding="utf-8")) if "rel=canonical" not in at]
        assert not found, f"{page.name}: {found}"
