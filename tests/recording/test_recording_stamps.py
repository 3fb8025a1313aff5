"""A recording whose logger rounds its time stamps and whose sensor's batches came twice."""

import json
from pathlib import Path

import numpy as np
import pytest

import midspan
from midspan.cli.main import run

RATE_HZ, MOTION_HZ = 199.7, 1.3


def recording(folder: Path, *, decimals: int, rows: list[int]) -> Path:
    """3 mm at 1.3 Hz by an accelerometer whose stamps have `decimals`, and by a sensor of 0.2 mm at 10 Hz."""
    rng = np.random.default_rng(5)
    turn = 2.0 * np.pi * MOTION_HZ
    fast_s, slow_s = np.arange(6000) / RATE_HZ, np.arange(300) / 10.0
    fast = -0.003 * turn**2 * np.sin(turn * fast_s) + rng.normal(0.0, 0.01, 6000)
    slow = 0.003 * np.sin(turn * slow_s) + rng.normal(0.0, 2e-4, 300)
    folder.mkdir()
    for name, time_s, value in (("a.csv", fast_s, fast), ("d.csv", slow_s[rows], slow[rows])):
        lines = (f"{t:.{decimals}f},{v:.6f}" for t, v in zip(time_s, value, strict=True))
        (folder / name).write_text("time_s,value\n" + "\n".join(lines) + "\n")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\nvalue = "value"\nunit = "m/s^2"\n'
        '[displacement]\nfile = "d.csv"\nvalue = "value"\nunit = "m"\n'
    )
    return folder


def error_mm(result: midspan.Result) -> float:
    """Rms of the displacement's error; the stamps of the result begin at the accelerometer's first one, zero."""
    table = result.to_pandas()
    time_s = np.arange(len(table)) / RATE_HZ
    return float(np.std(table["displacement_mm"].to_numpy() - 3.0 * np.sin(2.0 * np.pi * MOTION_HZ * time_s)))


def test_rounded_stamps_and_batches_that_came_twice_cost_nothing_and_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = midspan.estimate(recording(tmp_path / "whole", decimals=6, rows=list(range(300))))
    twice = [*range(200), *range(150, 200), *range(200, 300)]
    folder = recording(tmp_path / "rounded", decimals=2, rows=twice)
    mended = midspan.estimate(folder)
    # The same noise in both: what is left of 2.9 ms rms of rounding is below 0.01 ms.
    assert error_mm(mended) < 1.02 * error_mm(whole)
    texts = [str(one) for one in mended.warnings if one.code == "stamps-corrected"]
    assert any("accelerometer" in text and "rounded to 10 ms" in text for text in texts)
    assert any("displacement" in text and "50 duplicate rows" in text for text in texts)
    assert run(["inspect", str(folder), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert any("rounded to 10 ms" in note for note in tree["accelerometer"]["notes"])
    assert any("50 duplicate rows" in note for note in tree["displacement"]["notes"])
