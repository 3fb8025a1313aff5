"""The page left open: its heap is flat. `python -m benchmarks.live.open_page` shows it of eight hours."""

import pytest
from benchmarks.live.open_page import quarters_mb, readings_mb

from midspan.serve.application import PAGE

pytestmark = pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: make page")


def test_half_a_minute_of_the_page_adds_nothing_to_its_heap(browser, tmp_path):
    second, last = quarters_mb(readings_mb(browser, tmp_path / "store", 30.0 / 3600.0, 12))
    # Readings of a flat heap differ by 0.7 MB: an answer that was just drawn is in some of them.
    assert last - second < 1.0
    assert last < 20.0
