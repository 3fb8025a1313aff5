"""Deliberate mistakes, as users make them: each is refused or warned of, with the cause named."""

import json
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

import midspan
from midspan.cli.main import run
from midspan.errors import MidspanError
from midspan.settings.two_files import in_words_of_two_files
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.thermal.formats import open_pictures
from repeats import slow

GRAVITY = 9.80665
SECONDS, RATE_HZ, FRAMES_HZ = 30.0, 100.0, 10.0
# A refusal on the terminal; --verbose says more.
MAX_WORDS = 60
# Parts of the film, side by side: what the camera should look at, dirt on the lens, a thing with its own motion, sky.
TARGET, STILL, MOVER, SKY = ([4 + 90 * k, 8, 64, 64] for k in range(4))


@dataclass
class Desk:
    """A recording as its user has it, to be spoilt: columns of the accelerometer's file, frames, their times, keys."""

    time_s: np.ndarray
    up: np.ndarray
    displacement_mm: np.ndarray
    frames: np.ndarray
    frame_s: np.ndarray
    keys: dict[str, dict[str, object]]
    folder: Path

    def key(self, section: str, **values: object) -> None:
        self.keys.setdefault(section, {}).update(values)

    def first(self, length_s: float) -> None:
        """Leave the first seconds."""
        few = self.time_s < length_s
        self.time_s, self.up, self.displacement_mm = self.time_s[few], self.up[few], self.displacement_mm[few]
        self.frames = self.frames[: round(length_s * FRAMES_HZ)]
        self.frame_s = self.frame_s[: len(self.frames)]
        self.write()

    def write(self) -> None:
        rng = np.random.default_rng(5)
        across = rng.normal(0.0, 0.01, (2, len(self.time_s)))
        columns = {"time_s": self.time_s, "x": across[0], "y": across[1], "z": self.up, "mm": self.displacement_mm}
        np.savetxt(
            self.folder / "accel.csv",
            np.column_stack(list(columns.values())),
            fmt="%.6f",
            delimiter=",",
            header=",".join(columns),
            comments="",
        )
        np.save(self.folder / "film.npy", self.frames)
        np.savetxt(self.folder / "times.csv", self.frame_s, fmt="%.6f", header="time_s", comments="")
        (self.folder / "recording.toml").write_text(tomli_w.dumps(self.keys), encoding="utf-8")


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, acceleration, displacement of half a minute of the footbridge, and its film in four parts."""
    folder = tmp_path_factory.mktemp("film")
    assert run(["simulate", "footbridge", "-q", "-o", str(folder)]) == 0
    time_s, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    displacement = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)[:, 1]
    count, first = round(SECONDS * FRAMES_HZ), round(15.0 * FRAMES_HZ)
    source = open_pictures(folder / "camera.mkv", FrameRequest(rate_hz=FRAMES_HZ))
    seen = np.stack([frame.pixels[96:176, 108:188] for frame in source.frames(first, first + count)])
    noise = np.random.default_rng(3).normal(0.0, 1.0, (2, *seen.shape))
    still = np.clip(seen[0] + noise[0], 0, 255).astype(np.uint8)
    sky = np.clip(180.0 + noise[1], 0, 255).astype(np.uint8)
    gap = np.full((count, 80, 10), 90, dtype=np.uint8)
    frames = np.concatenate((seen, gap, still, gap, seen[::-1], gap, sky, gap), axis=2)
    used = slice(round(15.0 * RATE_HZ), round(45.0 * RATE_HZ))
    return time_s[used] - 15.0, value[used], displacement[used], frames


@pytest.fixture
def desk(film, tmp_path) -> Desk:
    time_s, value, displacement, frames = film
    camera = {"file": "film.npy", "rate_hz": FRAMES_HZ, "roi": TARGET, "direction": "y"}
    accelerometer = {"file": "accel.csv", "time": "time_s", "value": "z", "unit": "m/s^2"}
    return Desk(
        time_s,
        value - np.mean(value) + GRAVITY,
        displacement,
        frames.copy(),
        np.arange(len(frames)) / FRAMES_HZ,
        {"accelerometer": accelerometer, "camera": camera},
        tmp_path,
    )


def scaled(factor: float, unit: str) -> Callable[[Desk], None]:
    def spoil(desk: Desk) -> None:
        desk.up = desk.up * factor
        desk.key("accelerometer", unit=unit)

    return spoil


def keys(section: str, **values: object) -> Callable[[Desk], None]:
    return lambda desk: desk.key(section, **values)


def level_and_optics(desk: Desk) -> None:
    desk.up = desk.up - GRAVITY
    desk.key("accelerometer", unit="g")
    # The simulated camera: 1.5 mm a pixel.
    desk.key("camera", distance_m=15.0, focal_length_mm=50.0, pixel_pitch_um=5.0)


def milliseconds(desk: Desk) -> None:
    desk.time_s = 1e3 * desk.time_s


def sign_of_times(desk: Desk) -> None:
    desk.time_s = desk.time_s[::-1]


def apart(desk: Desk) -> None:
    desk.frame_s = desk.frame_s + 3600.0
    desk.key("camera", times="times.csv", rate_hz=None)


def other_day(desk: Desk) -> None:
    value = desk.up - GRAVITY
    desk.up = GRAVITY + value[::-1]


def rotated(desk: Desk) -> None:
    desk.frames = np.ascontiguousarray(desk.frames[:, :, :90].transpose(0, 2, 1))
    desk.key("camera", roi=[8, 4, 64, 64])


def stabilised(desk: Desk) -> None:
    rng = np.random.default_rng(2)
    steady = desk.frames[:1, :, 90:170].astype(float) + rng.normal(0.0, 1.0, desk.frames[:, :, 90:170].shape)
    desk.frames[:, :, :80] = np.clip(steady, 0, 255).astype(np.uint8)


def displacement_as_acceleration(desk: Desk) -> None:
    desk.key("accelerometer", value="mm")


def thinned_and_held(desk: Desk) -> None:
    desk.up = np.repeat(desk.up[::10], 10)[: len(desk.up)]


def thinned(desk: Desk) -> None:
    desk.time_s, desk.up, desk.displacement_mm = desk.time_s[::25], desk.up[::25], desk.displacement_mm[::25]


def drops_frames(desk: Desk) -> None:
    kept = np.ones(len(desk.frames), dtype=bool)
    kept[[90, 91, 92, 160, 161, 220]] = False
    desk.frames = desk.frames[kept]


def repeats_frames(desk: Desk) -> None:
    desk.frames = np.repeat(desk.frames[::2], 2, axis=0)


def clipped(desk: Desk) -> None:
    middle, reach = GRAVITY, 0.2 * np.max(np.abs(desk.up - GRAVITY))
    desk.up = np.clip(desk.up, middle - reach, middle + reach)


def other_clock(desk: Desk) -> None:
    desk.frame_s = desk.frame_s + 4.0
    desk.key("camera", times="times.csv", rate_hz=None)


def half_a_second(desk: Desk) -> None:
    other_clock(desk)
    desk.key("calibration", max_offset_s=0.5)


def too_short(desk: Desk) -> None:
    desk.frames, desk.frame_s = desk.frames[:12], desk.frame_s[:12]


def at_rest(desk: Desk) -> None:
    rng = np.random.default_rng(1)
    desk.up = GRAVITY + rng.normal(0.0, 0.002, len(desk.up))
    stabilised(desk)


def cut_off(desk: Desk) -> None:
    desk.write()
    file = desk.folder / "accel.csv"
    file.write_bytes(file.read_bytes()[:-15])


def decimal_comma(desk: Desk) -> None:
    desk.write()
    file = desk.folder / "accel.csv"
    file.write_text(file.read_text().replace(".", ","))


def frames_cut_off(desk: Desk) -> None:
    desk.write()
    os.truncate(desk.folder / "film.npy", os.path.getsize(desk.folder / "film.npy") // 2)


# name: what is spoilt, exit code, and what is said.
MISTAKES: dict[str, tuple[Callable[[Desk], None], int, str]] = {
    "m/s² declared as g": (scaled(1.0, "g"), 0, r"serious: .*unit.*\[unit-doubtful\]"),
    "g declared as m/s²": (scaled(1.0 / GRAVITY, "m/s^2"), 0, r"serious: .*unit.*\[unit-doubtful\]"),
    "mg declared as m/s²": (scaled(1e3 / GRAVITY, "m/s^2"), 0, r"serious: .*unit.*\[unit-doubtful\]"),
    "g declared as gal": (scaled(1.0 / GRAVITY, "gal"), 0, r"serious: .*1 g in g .* 981 times.*\[unit-doubtful\]"),
    "g declared as mg": (scaled(1.0 / GRAVITY, "mg"), 0, r"serious: .*1 g in g .* 1e\+03 times.*\[unit-doubtful\]"),
    "m/s² declared as mm/s²": (scaled(1.0, "mm/s^2"), 0, r"serious: .*1 g in m/s\^2 .*\[unit-doubtful\]"),
    "m/s² declared as g, gravity taken off": (level_and_optics, 0, r"accelerometer.unit.*\[scale-implausible\]"),
    "unit that is no acceleration": (keys("accelerometer", unit="cm"), 2, "unit.*cm"),
    "channel of another axis": (keys("accelerometer", value="x"), 4, "Check camera.direction .*accelerometer.value"),
    "channel that is not there": (keys("accelerometer", value="accel_z"), 2, "accel_z.*'z'"),
    "displacement as acceleration": (displacement_as_acceleration, 4, "accelerometer.value"),
    "image axes swapped": (
        keys("camera", direction="x"),
        4,
        "the image does not: check camera.direction",
    ),
    "film rotated": (rotated, 4, "the image does not: check camera.direction"),
    "film stabilised": (stabilised, 4, "the image does not: .*no stabiliser"),
    "region on dirt on the lens": (keys("camera", roi=STILL), 4, "the image does not: .*fixed to the camera"),
    "region on something that moves on its own": (
        keys("camera", roi=MOVER),
        4,
        "both move, but too differently.*camera.roi",
    ),
    "region on the sky": (keys("camera", roi=SKY), 2, "roi must hold texture"),
    "region outside the picture": (keys("camera", roi=[400, 8, 64, 64]), 2, "roi"),
    "another frame rate": (keys("camera", rate_hz=12.0), 4, "wrong camera.rate_hz"),
    "slow motion played at a quarter of its speed": (keys("camera", rate_hz=FRAMES_HZ / 4), 4, "slow-motion video"),
    "times in milliseconds": (milliseconds, 4, "times are in ms"),
    "decimal comma and comma between columns": (
        decimal_comma,
        2,
        "comma seems to separate both columns and decimals",
    ),
    "times backwards": (sign_of_times, 3, "increas|back"),
    "logger and film an hour apart": (apart, 3, "overlap"),
    # The scenario's own clocks are 0.14 s apart.
    "logger and film four seconds apart": (
        other_clock,
        0,
        r"clock offset is -3.86 s by the motion.*\[clock-corrected\]",
    ),
    "logger and film four seconds apart, half a second stated": (half_a_second, 4, "clocks seem to differ by"),
    "files of different days": (other_day, 4, "both files are of the same event"),
    "acceleration thinned to 4 Hz": (thinned, 4, "4 samples per second.*decimated"),
    "acceleration held between samples": (thinned_and_held, 0, r"only every 10th sample.*\[rate-too-low\]"),
    "acceleration clipped": (clipped, 3, "clipped"),
    "camera that drops frames": (drops_frames, 4, "lost or doubled frames"),
    "camera that repeats frames": (repeats_frames, 0, r"\[frozen\]"),
    "film of a second": (too_short, 4, "Only 9 usable frames"),
    "nothing moves": (at_rest, 4, "Too little motion.*Choose a calibration.window_s with traffic"),
    "logger's file cut off": (cut_off, 0, r"\[file-damaged\]"),
    "film cut off": (frames_cut_off, 3, "film.npy"),
}


def words_of(error: MidspanError) -> int:
    """How many words of a refusal `estimate` prints of two files, where it leads to the keys' file as well."""
    with pytest.raises(MidspanError) as refused, in_words_of_two_files(Path("accel.csv"), Path("film.mkv")):
        raise type(error)(str(error))
    pointer = "--verbose lists figures and other causes." if error.more else ""
    return len(f"midspan: {refused.value} {pointer}".split())


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_or_warned_of_with_its_cause(mistake: str, desk: Desk, capsys) -> None:
    spoil, code, said = MISTAKES[mistake]
    spoil(desk)
    desk.keys = {name: {k: v for k, v in own.items() if v is not None} for name, own in desk.keys.items()}
    if not (desk.folder / "accel.csv").exists():
        desk.write()
    if code:
        with pytest.raises(MidspanError) as refused:
            midspan.estimate(desk.folder)
        found, text = refused.value.exit_code, f"{refused.value} {refused.value.more}"
        assert words_of(refused.value) <= MAX_WORDS, str(refused.value)
    else:
        found, text = run(["calibrate", str(desk.folder)]), capsys.readouterr().err
    assert (found, bool(re.search(said, text))) == (code, True), text


def calibrated(desk: Desk) -> dict[str, Any]:
    """The calibration of the recording as it should be, as its file holds it."""
    desk.write()
    assert run(["calibrate", str(desk.folder), "-q"]) == 0
    return json.loads((desk.folder / "calibration.json").read_text())


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "The sign is reversed"), (1.3, "scale_mm_per_px does not belong")])
def test_a_calibration_of_another_set_up_is_refused(desk: Desk, capsys, factor: float, said: str) -> None:
    tree = calibrated(desk)
    tree["camera"]["scale_mm_per_px"] *= factor
    (desk.folder / "other.json").write_text(json.dumps(tree))
    # Twelve seconds show it: where all frames are refused, the estimator follows many explanations of them.
    desk.first(12.0)
    assert run(["estimate", str(desk.folder), "-c", str(desk.folder / "other.json")]) == 4
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("value", "said"), [("Z-axis", "is not in the file"), ("mm", "unit must measure acceleration")]
)
def test_a_wrong_value_for_two_files_is_named(desk: Desk, capsys, value: str, said: str) -> None:
    desk.write()
    files = [str(desk.folder / "accel.csv"), str(desk.folder / "film.npy")]
    unit = ["--unit", "mm"] if value == "mm" else ["--unit", "m/s^2"]
    assert run(["estimate", *files, "--value", value, *unit]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("unit", "code"), [("(m/s^2)", 0), ("", 0)])
def test_a_channel_with_a_share_of_the_motion_of_another_is_warned_of(desk: Desk, capsys, unit: str, code: int) -> None:
    desk.key("accelerometer", value="y")
    desk.write()
    shares = np.column_stack((desk.time_s, 0.02 * (desk.up - GRAVITY) - 0.2, desk.up))
    heading = f"time_s,y {unit},z {unit}"
    np.savetxt(desk.folder / "accel.csv", shares, fmt="%.6f", delimiter=",", header=heading, comments="")
    assert run(["calibrate", str(desk.folder)]) == code
    assert re.search(r"serious: .*'z' has 50 times the motion of 'y' and carries gravity.*", capsys.readouterr().err)


@pytest.mark.parametrize("spoil", [other_clock, *slow(lambda desk: None)])
def test_the_picture_shows_the_region_that_an_estimate_takes(desk: Desk, capsys, spoil: Callable[[Desk], None]) -> None:
    spoil(desk)
    desk.keys["camera"].pop("roi")
    desk.keys = {name: {k: v for k, v in own.items() if v is not None} for name, own in desk.keys.items()}
    desk.write()
    picture, files = str(desk.folder / "look.png"), [str(desk.folder / name) for name in ("accel.csv", "film.npy")]
    asked = ["--value", "z", "--unit", "m/s^2", "--rate-hz", f"{FRAMES_HZ:g}"]
    pairs = [([str(desk.folder)], "result.csv", []), (files, "film.csv", asked)]
    for given, result, more in pairs:
        capsys.readouterr()
        assert run(["inspect", *given, *more, "--picture", picture, "--json"]) == 0
        regions = json.loads(capsys.readouterr().out)["regions"]
        assert run(["estimate", *given, *more, "-o", str(desk.folder / result), "-q"]) == 0
        taken = json.loads((desk.folder / result).with_suffix(".json").read_text())["calibration"]["camera"]["roi"]
        assert regions["chosen"] == [taken]
        assert taken in [place["roi"] for place in regions["places"]]


def test_the_recording_without_a_mistake_has_no_warning(desk: Desk, capsys) -> None:
    assert calibrated(desk)["notices"] == []
    assert capsys.readouterr().err == ""
