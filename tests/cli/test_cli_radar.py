"""The commands on a radar's recording, and what they say of files and settings that do not fit."""

import json
import shutil

import numpy as np
import pytest

from midspan.cli.main import run
from midspan.simulate.radar.signal import Reflector
from radar_recordings import PLATE, Case, write
from recording_edits import set_keys

WALL = Reflector(3.4, 900.0, ratio=1 / 1.27, azimuth_rad=0.2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write(tmp_path_factory.mktemp("radar") / "capture", Case((WALL, PLATE), frames=1500))


def settings(old, new):
    def change(folder):
        text = (folder / "radar.cfg").read_text()
        assert text.count(old) == 1
        (folder / "radar.cfg").write_text(text.replace(old, new))

    return change


def words(change):
    def changed(folder):
        file = folder / "adc_data.bin"
        change(np.fromfile(file, "<i2")).astype("<i2").tofile(file)

    return changed


def keys(**values):
    return lambda folder: set_keys(folder, "radar", **values)


# 1500 frames of 2 receivers × 64 samples × 4 bytes are 768000 bytes.
BAD = {
    "samples": (settings(" 64 6000", " 128 6000"), 3, ("1024 bytes a frame", "512 bytes a frame", "radar.config")),
    "receivers": (settings("channelCfg 3", "channelCfg 15"), 3, ("4 receivers", "1024 bytes a frame", "768000 bytes")),
    "frames": (settings("0 0 1 1500", "0 0 1 1000"), 3, ("1000 frames are 512000 bytes", "found are 768000 bytes")),
    "unknown device": (settings("xWR1642", "xWR2944"), 3, ("xWR2944", "not known", "xWR16xx")),
    "wrong order": (keys(iq_order="IIQQ"), 3, ("radar.iq_order = 'IIQQ'", "dB", "QQII")),
    "no such order": (keys(iq_order="QIIQ"), 2, ("radar.iq_order = 'QIIQ'", "IQIQ")),
    "saturated": (words(lambda w: np.clip(w * 60.0, -32768, 32767)), 3, ("saturated", "at most 1 %", "gain")),
    "zeros": (words(lambda w: 0 * w), 3, ("only zeros", "512 bytes")),
    "empty": (lambda folder: (folder / "adc_data.bin").write_bytes(b"") and None, 3, ("empty (0 bytes)",)),
    "no config": (keys(config=None), 2, ("radar.config", ".cfg")),
    "config is missing": (keys(config="other.cfg"), 3, ("radar.config = 'other.cfg'", "no such file")),
    "file is missing": (keys(file="other.bin"), 3, ("radar.file = 'other.bin'", "no such file")),
    "no radar data": (keys(file="accel.csv"), 2, ("accel.csv", ".bin, .h5, .hdf5, .npy")),
    "unknown key": (keys(confg="radar.cfg"), 2, ("radar.confg", "Did you mean 'config'?")),
    "no targets": (keys(targets=0), 2, ("radar.targets = 0", "greater than or equal to 1")),
    "other day": (keys(start_s=86400.0), 3, ("accelerometer and radar do not overlap", "radar.start_s")),
    "noise alone": (
        words(lambda w: np.random.default_rng(0).normal(0.0, 200.0, w.size)),
        4,
        ("detects no target", "4 dB above the noise"),
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_radar_input_ends_with_its_code_and_says_what_to_do(whole, tmp_path, capsys, name) -> None:
    change, code, said = BAD[name]
    folder = shutil.copytree(whole, tmp_path / "bad")
    change(folder)
    before = {path.name for path in folder.iterdir()}
    assert run(["estimate", str(folder)]) == code
    message = capsys.readouterr().err
    assert "Traceback" not in message
    for part in said:
        assert part in message
    assert {path.name for path in folder.iterdir()} == before


def test_calibrate_prints_a_row_for_each_target_with_its_verdict(whole, tmp_path, capsys) -> None:
    folder = shutil.copytree(whole, tmp_path / "good")
    assert run(["calibrate", str(folder)]) == 0
    out = capsys.readouterr().out
    assert "radar conversion factor" in out
    row = next(line for line in out.splitlines() if "radar target at 3.4" in line)
    assert row.endswith("used")
    for part in ("dB", "factor 1.27", "coherence"):
        assert part in row
    assert run(["estimate", str(folder), "-c", str(folder / "calibration.json"), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["calibration"]["radar"]["conversion_factor"] == pytest.approx(1.27, rel=0.005)
    assert (folder / "result.csv").read_text().splitlines()[1].endswith("radar,tracking")


def test_inspect_shows_the_radar_and_fails_where_it_cannot_be_read(whole, tmp_path, capsys) -> None:
    assert run(["inspect", str(whole)]) == 0
    out = capsys.readouterr().out
    for part in ("1500 frames, 2 channels", "limit speed", "(bin 15."):
        assert part in out
    folder = shutil.copytree(whole, tmp_path / "bad")
    settings(" 64 6000", " 128 6000")(folder)
    assert run(["inspect", str(folder)]) == 3
    assert "cannot be used" in capsys.readouterr().out


def test_track_formats_and_check_config_know_a_recording_with_a_radar_alone(whole, tmp_path, capsys) -> None:
    assert run(["track", str(whole), "-o", str(tmp_path / "track.csv")]) == 2
    message = capsys.readouterr().err
    assert "no [camera]" in message
    assert "midspan estimate" in message
    assert run(["formats"]) == 0
    assert "DCA1000" in capsys.readouterr().out
    folder = shutil.copytree(whole, tmp_path / "alone")
    set_keys(folder, "radar", config="gone.cfg")
    assert run(["check-config", str(folder)]) == 0
    assert "radar.config = 'gone.cfg': no such file yet" in capsys.readouterr().err


def test_results_are_never_written_over_the_radars_files(whole, capsys) -> None:
    for name in ("adc_data.bin", "radar.cfg"):
        assert run(["calibrate", str(whole), "-o", str(whole / name)]) == 2
        assert name in capsys.readouterr().err
