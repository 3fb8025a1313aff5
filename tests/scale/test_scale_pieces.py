"""Long recordings in pieces: joined rows equal the whole's within the stated rounding, or the recording stays whole."""

import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import midspan
from midspan.recording import pieces
from midspan.scale.pieces import Piece, work_piece
from midspan.scale.work import Cut, Task, work

RATE_HZ, LENGTH_S = 50.0, 1200.0
# Stated for rows far from what no sensor saw, and for those in between; see docs/campaigns.md.
ROUNDING, ROUNDING_UNSEEN = 0.01, 0.02
RECORDING = """
[accelerometer]
file = "accel.parquet"
time = "time_s"
value = "accel"
unit = "m/s^2"
[displacement]
file = "gnss.parquet"
time = "time_s"
value = "height"
unit = "mm"
"""


def written(folder, *, settles_mm=0.0, gap_s=(), shifts_mm=0.0):
    """A campaign of one recording: four modes (analytic) and a GNSS of 1.5 mm at 5 Hz.

    settles_mm: by how much the structure settles within a second; shifts_mm: by how much the GNSS' zero steps.
    """
    rng = np.random.default_rng(5)
    t = np.arange(round(LENGTH_S * RATE_HZ)) / RATE_HZ
    u, a = np.zeros_like(t), np.zeros_like(t)
    for frequency_hz, amplitude_m in ((0.05, 3e-3), (0.4, 6e-3), (1.1, 2e-3), (2.3, 0.6e-3)):
        for k in range(3):
            omega, phase = 2.0 * np.pi * frequency_hz * (1.0 + 0.003 * (k - 1.5)), rng.uniform(0.0, 2.0 * np.pi)
            u += 0.5 * amplitude_m * np.cos(omega * t + phase)
            a -= 0.5 * amplitude_m * omega**2 * np.cos(omega * t + phase)
    turns = 2.0 * np.pi * np.clip(t - 0.55 * LENGTH_S, 0.0, 1.0)
    u += 1e-3 * settles_mm * (turns - np.sin(turns)) / (2.0 * np.pi)
    a += 1e-3 * settles_mm * 2.0 * np.pi * np.sin(turns)
    a += 0.02 + 0.005 * rng.standard_normal(len(t))
    gnss = pd.DataFrame({"time_s": t[::10], "height": 1e3 * u[::10] + 1.5 * rng.standard_normal(len(t[::10]))})
    gnss.loc[gnss["time_s"] > 0.55 * LENGTH_S, "height"] += shifts_mm
    if gap_s:
        gnss = gnss[(gnss["time_s"] < gap_s[0]) | (gnss["time_s"] > gap_s[1])]
    (folder / "a").mkdir()
    pd.DataFrame({"time_s": t, "accel": a}).to_parquet(folder / "a" / "accel.parquet")
    gnss.to_parquet(folder / "a" / "gnss.parquet")
    (folder / "a" / "recording.toml").write_text(RECORDING)
    (folder / "CAMPAIGN.toml").write_text('recordings = ["a"]\noutput = "results"\n')
    return folder


@pytest.fixture
def short(monkeypatch):
    """Pieces of less than seven minutes in place of three hours or more."""
    monkeypatch.setattr(pieces, "PIECE_SAMPLES", 1)
    monkeypatch.setattr(pieces, "PIECE_S", 399.0)
    monkeypatch.setattr(pieces, "OVERLAP_S", 120.0)


def parts_of(folder):
    return sorted((folder / "results" / "rows" / "recording=a").iterdir())


def test_joined_pieces_are_the_whole_within_the_rounding_across_a_jump_and_a_gap(short, tmp_path):
    folder = written(tmp_path, settles_mm=8.0, gap_s=(320.0, 340.0))
    (outcome,) = midspan.batch(folder, runner="local").outcomes
    whole = midspan.estimate(folder / "a")
    rows = pd.read_parquet(folder / "results" / "rows")
    assert [one.name for one in parts_of(folder)] == [f"part-{k:04d}.parquet" for k in range(3)]
    assert (outcome.exit_code, outcome.rows) == (0, len(whole.time_s))
    # No row is missing or doubled, and a set is read in the order of time.
    assert np.array_equal(rows["time_s"], whole.time_s)
    assert np.array_equal(rows["status"].astype(str), whole.to_pandas()["status"].astype(str))
    apart = np.abs(rows["displacement_mm"] - whole.displacement_mm) / whole.displacement_std_mm
    assert apart.max() < ROUNDING_UNSEEN
    assert apart[np.abs(whole.time_s - 330.0) > 20.0].max() < ROUNDING
    wider = np.abs(rows["displacement_std_mm"] / whole.displacement_std_mm - 1.0)
    assert wider.max() < ROUNDING
    assert set(outcome.warnings) == {str(getattr(line, "code", "")) for line in whole.warnings}
    assert not (folder / "results" / "pieces").exists()


def test_what_a_piece_cannot_know_leaves_the_recording_whole(short, tmp_path):
    # The zero of the first minutes is known for ever, and no later piece knows it.
    folder = written(tmp_path, shifts_mm=25.0)
    (outcome,) = midspan.batch(folder, runner="local").outcomes
    whole = midspan.estimate(folder / "a")
    assert outcome.exit_code == 0
    assert [one.name for one in parts_of(folder)] == ["part.parquet"]
    assert np.array_equal(pd.read_parquet(folder / "results" / "rows")["displacement_mm"], whole.displacement_mm)


def test_pieces_that_are_done_are_taken_after_an_interruption(short, tmp_path):
    folder = written(tmp_path)
    midspan.batch(folder, runner="local")
    undisturbed = pd.read_parquet(folder / "results" / "rows")
    shutil.rmtree(folder / "results")
    (task,) = _tasks(folder)
    cut = work(task)
    assert isinstance(cut, Cut)
    for number in (0, 2):
        work_piece(Piece(cut, number))
    # A part without its seams is not done: the worker was killed between the two.
    shutil.copy(Piece(cut, 0).rows_file, Piece(cut, 1).rows_file)
    kept = Piece(cut, 2).rows_file.stat().st_ino
    assert not (folder / "results" / "rows").exists()
    midspan.batch(folder, runner="local")
    # To the last bit.
    pd.testing.assert_frame_equal(pd.read_parquet(folder / "results" / "rows"), undisturbed, check_exact=True)
    assert parts_of(folder)[2].stat().st_ino == kept


def test_a_recording_that_was_in_pieces_can_become_one_again(short, tmp_path, monkeypatch):
    folder = written(tmp_path)
    midspan.batch(folder, runner="local")
    assert len(parts_of(folder)) == 3
    monkeypatch.setattr(pieces, "PIECE_S", 10_800.0)
    changed = folder / "a" / "recording.toml"
    changed.write_text(changed.read_text() + "\n# again\n")
    (outcome,) = midspan.batch(folder, runner="local").outcomes
    assert [one.name for one in parts_of(folder)] == ["part.parquet"]
    assert len(pd.read_parquet(folder / "results" / "rows")) == outcome.rows


def _tasks(folder):
    from midspan.scale.jobs import jobs_of
    from midspan.settings.campaign import load_campaign

    settings, file = load_campaign(folder)
    return [Task(job, folder / settings.output) for job in jobs_of(settings, file.parent)[0]]


def test_only_long_tables_that_are_smoothed_are_cut(short, tmp_path):
    recording = midspan.open_recording(written(tmp_path) / "a")
    assert pieces.may_be_cut(recording, None)
    assert not pieces.may_be_cut(recording, "kalman")
    film = SimpleNamespace(settings=recording.settings, sensors=(SimpleNamespace(kind="camera"),))
    assert not pieces.may_be_cut(film, None)
