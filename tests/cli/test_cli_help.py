"""`midspan help`, shell completion, and the sentences on keys that other commands show."""

import os
import subprocess
import sys

import pytest

from midspan.cli.main import run
from midspan.settings.keys import calibration_sections, described, recording_sections, site_sections
from midspan.settings.recording import FusionSettings

LAG = FusionSettings.model_fields["lag_s"].description


def shown(topic, capsys):
    assert run(["help", *topic]) == 0
    return capsys.readouterr().out


def test_without_a_topic_commands_and_sections_are_listed(capsys):
    text = shown([], capsys)
    assert "check-config" in text
    assert "camera.lens" in text
    assert "point.alarm" in text


def test_a_command_is_explained_as_its_help_does(capsys):
    assert run(["estimate", "--help"]) == 0
    text = capsys.readouterr().out
    assert shown(["estimate"], capsys) == text


@pytest.mark.parametrize("topic", ["fusion", "[fusion]", "fusion.lag_s", "lag_s"])
def test_a_section_or_a_key_is_explained_by_the_sentence_of_its_field(topic, capsys):
    text = shown([topic], capsys)
    assert "1e-6 … 3600 s, default 0.5" in text
    assert LAG in text


def test_a_section_of_two_files_is_shown_of_both(capsys):
    text = shown(["accelerometer"], capsys)
    assert "[accelerometer] of recording.toml" in text
    assert "[accelerometer] of calibration.json" in text


def test_an_unknown_topic_names_the_nearest(capsys):
    assert run(["help", "fusoin"]) == 2
    assert "Did you mean 'fusion'?" in capsys.readouterr().err


def test_check_config_shows_what_each_key_means(tmp_path, capsys):
    (tmp_path / "recording.toml").write_text('[accelerometer]\nfile = "a.csv"\n[[camera]]\nfile = "c.mkv"\n')
    assert run(["check-config", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    line = next(line for line in text.splitlines() if "fusion.lag_s" in line)
    assert line.endswith(f"# {LAG}")
    assert described(recording_sections(), "camera.every") in text


def test_a_place_in_a_list_of_sections_is_described(capsys):
    assert described(recording_sections(), "camera[2].target[1].roi") == described(
        recording_sections(), "camera.target.roi"
    )
    assert described(site_sections(), "point[1].alarm[2].limit_mm")
    assert described(recording_sections(), "camera.nonsense") == ""


def test_ranges_and_forms_are_those_of_the_models():
    keys = {(one.name, key.name): key.values for one in recording_sections() for key in one.keys}
    assert keys["accelerometer", "rate_hz"] == "1e-6 … 1e9 Hz"
    assert keys["fusion", "forgetting"] == "above 0 … below 1"
    assert keys["fusion", "taps"] == "odd, 9 … 1500"
    assert keys["camera", "roi"] == "4 whole numbers, px"
    assert keys["camera", "direction"] == "x, y, xy"
    assert keys["calibration", "max_offset_s"] == "0 … 3600 s"
    units = {key.name: key.values for one in calibration_sections() for key in one.keys}
    assert units["scale_mm_per_px"] == "mm/px"
    assert units["bias_drift_m_s3"] == "m/s³"


# The command is run as a shell runs it: by its module, with words and position in the environment.
@pytest.mark.parametrize(("words", "offered"), [("midspan est", "estimate"), ("midspan estimate --rep", "--report")])
def test_a_shell_completes_commands_and_options(words, offered):
    environment = os.environ | {
        "_MIDSPAN_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    asked = subprocess.run(
        [sys.executable, "-m", "midspan"], env=environment, capture_output=True, text=True, check=True
    )
    assert asked.stdout.splitlines() == [f"plain,{offered}"]


def test_the_module_is_the_command():
    asked = subprocess.run([sys.executable, "-m", "midspan", "--version"], capture_output=True, text=True, check=True)
    assert asked.stdout.startswith("midspan ")
