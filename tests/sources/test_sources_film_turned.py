"""Films that are turned for display: seen as a player shows them, and reported so."""

import numpy as np
import pytest

import film_matrix
import midspan
from film_matrix import LEFT, MIRRORED, OVER, RIGHT, SLANTED
from midspan.cli.main import run
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest

ROWS, COLUMNS, COUNT = 96, 64, 12
ROI = (20, 40, 32, 24)
READOUT_S = 0.02
TURNS = {"right": RIGHT, "left": LEFT, "over": OVER}


@pytest.fixture(scope="module")
def upright():
    """Blurred noise that moves right by 0, 1 or 2 px and down by 0 to 3 px."""
    rng = np.random.default_rng(3)
    wide = np.kron(rng.integers(40, 200, (30, 20)), np.ones((4, 4))).astype(np.uint8)
    moved = [(k % 3, k % 4) for k in range(COUNT)]
    return np.stack([wide[10 - down : 10 - down + ROWS, 8 - right : 8 - right + COLUMNS] for right, down in moved])


@pytest.mark.parametrize("turn", TURNS)
def test_a_turned_film_is_read_and_tracked_as_a_player_shows_it(upright, tmp_path, turn):
    matrix = TURNS[turn]
    film = film_matrix.write(tmp_path / "phone.mp4", film_matrix.stored_for(upright, matrix), matrix=matrix)
    source = open_frames(film, FrameRequest())
    assert (source.info.width, source.info.height) == (COLUMNS, ROWS)
    # Stored without loss: the same pixels, each in its place.
    for frame, picture in zip(source.frames(), upright, strict=True):
        np.testing.assert_array_equal(frame.pixels, picture)
        assert frame.pixels.flags.c_contiguous
    as_shown = film_matrix.write(tmp_path / "upright.mp4", upright)
    found, expected = (midspan.track(path, roi=ROI) for path in (film, as_shown))
    np.testing.assert_array_equal(found.track.x_px, expected.track.x_px)
    np.testing.assert_array_equal(found.track.y_px, expected.track.y_px)
    np.testing.assert_allclose(found.track.y_px, np.arange(COUNT) % 4, atol=0.05)
    assert [one.code for one in found.warnings if one not in expected.warnings] == ["film-turned"]


@pytest.mark.parametrize("matrix", [MIRRORED, SLANTED], ids=["mirrored", "slanted"])
def test_what_is_no_quarter_turn_is_left_and_reported(upright, tmp_path, capsys, matrix):
    film = film_matrix.write(tmp_path / "odd.mp4", upright, matrix=matrix)
    first = next(open_frames(film, FrameRequest()).frames())
    np.testing.assert_array_equal(first.pixels, upright[0])
    assert run(["inspect", str(film)]) == 0
    assert "90 degrees, is ignored" in capsys.readouterr().out


def test_inspect_says_that_a_film_was_turned_and_gives_the_size_shown(upright, tmp_path, capsys):
    film = film_matrix.write(tmp_path / "phone.mp4", film_matrix.stored_for(upright, RIGHT), matrix=RIGHT)
    assert run(["inspect", str(film)]) == 0
    text = capsys.readouterr().out
    assert f"{COLUMNS} × {ROWS} px" in text
    assert "rotated by 90 degrees to the right (display matrix)" in text
    film_matrix.write(tmp_path / "plain.mp4", upright, matrix=(1, 0, 0, 1))
    assert run(["inspect", str(tmp_path / "plain.mp4")]) == 0
    assert "matrix" not in capsys.readouterr().out


def recording(folder, film, roi):
    """A recording of a film with a rolling shutter."""
    folder.mkdir()
    time = np.arange(0.0, 1.4, 0.01)
    rows = "\n".join(f"{t:.2f},{np.sin(9.0 * t):.6f}" for t in time)
    (folder / "accel.csv").write_text(f"time_s,a\n{rows}\n")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nvalue = "a"\nunit = "m/s^2"\n'
        f'[camera]\nfile = "{film.as_posix()}"\nroi = {list(roi)}\nreadout_s = {READOUT_S}\n'
    )
    return folder


@pytest.mark.parametrize("turn", TURNS)
def test_a_rolling_shutter_goes_along_the_rows_of_the_sensor(upright, tmp_path, turn):
    matrix, stored = TURNS[turn], film_matrix.stored_for(upright, TURNS[turn])
    film = film_matrix.write(tmp_path / "phone.mp4", stored, matrix=matrix)
    found = midspan.track(recording(tmp_path / "shown", film, ROI))
    # The middle of the target in the stored picture, whose rows are read out from the first to the last.
    x = ROI[0] + 0.5 * (ROI[2] - 1) + found.track.x_px
    y = ROI[1] + 0.5 * (ROI[3] - 1) + found.track.y_px
    row = {"right": COLUMNS - 1 - x, "left": x, "over": ROWS - 1 - y}[turn]
    late_s = READOUT_S * row / (stored.shape[1] - 1)
    # Stamps of the container are whole ticks of 1/10240 s here, exact at 0.1 s; the rows' are rounded to ns.
    np.testing.assert_allclose(found.track.time_ns, 1e9 * (0.1 * np.arange(COUNT) + late_s), atol=2.0)
