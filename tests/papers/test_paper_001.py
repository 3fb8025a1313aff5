"""The paper on vision and infrared (Choi, Ma, Kim and Sohn) from temperatures to rows, its steps in plain NumPy."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lively_recordings import COLDEST_C, KELVIN_PER_LEVEL, Lively, write
from midspan.cli.main import run
from midspan.records import Frame, Prediction, Region, Status
from midspan.sinks.metadata import partner
from midspan.vision.tracker import open_tracker, tracker_settings
from plain_filters import adaptive_kalman, printed_calibration
from recording_edits import set_keys

CASE = Lively(
    3, first_s=0.0137, rate_hz=20.0, duration_s=46.0, tones=((6e-3, 0.8), (2e-3, 1.7)), noise_m_s2=2e-3, mm_per_px=-1.6
)
ROI = Region(18, 18, 48, 48)
CALIBRATED_S, FADED_S = (0.0, 24.0), (26.0, 42.0)
# D and Q + 1 of equations 10 to 14.
AFTER, AVERAGE = 30, 10


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    """A recording whose warm and cold places change while it moves, and the command's result, with its JSON."""
    folder = write(tmp_path_factory.mktemp("infrared") / "recording", CASE, "infrared")
    # Another pattern, moved alike, takes over within seconds: the first one seen from its other side.
    celsius = np.load(folder / "infrared.npz")["celsius"]
    share = np.clip((CASE.met_s - FADED_S[0]) / (FADED_S[1] - FADED_S[0]), 0.0, 1.0)[:, None, None]
    np.savez(folder / "infrared.npz", celsius=((1.0 - share) * celsius + share * celsius[:, :, ::-1]).astype("f4"))
    set_keys(folder, "accelerometer", noise_std=2e-3)
    set_keys(folder, "infrared", reference="updating", reference_settings={"literal": True})
    set_keys(folder, "calibration", window_s=list(CALIBRATED_S))
    set_keys(folder, "fusion", start_noise_mm=0.5, start_velocity_mm_s=50.0, input_noise_m_s2=2e-3)
    asked = ["--tracker", "features", "--method", "adaptive-kalman", "--literal", "--quiet"]
    assert run(["estimate", str(folder), *asked]) == 0
    table = np.genfromtxt(folder / "result.csv", delimiter=",", names=True, dtype=None, encoding=None)
    return folder, table, json.loads(partner(folder / "result.csv").read_text())


class Updating:
    """Section 2.2.2, equations 10 to 14, cases 1 to 3, along y."""

    def __init__(self, first):
        self.first = self.take(first, ROI, 0.0)
        self.now, self.last, self.updates, self.count = self.first, None, 0, 0

    def take(self, frame, region, place_px):
        """A reference frame with where it is, and what is known of it: frame number, matches, threshold."""
        settings = tracker_settings("features", literal=True)
        tracker = open_tracker("features", frame, region, settings)
        return {"tracker": tracker, "place": place_px, "since": 0, "matches": [], "least": None}

    def measured(self, reference, frame, y_px, std_px):
        """Equations 11 and 13, and case 2."""
        ahead = None if y_px is None else Prediction(0.0, y_px - reference["place"], 1.0, std_px)
        found = reference["tracker"].push(frame, ahead)
        reference["matches"].append(found.strength)
        if reference["least"] is None and len(reference["matches"]) == AFTER:
            reference["least"] = np.mean(reference["matches"]) - 3.0 * np.std(reference["matches"])
        return found.y_px + reference["place"], found

    def push(self, frame, y_px=None, std_px=None):
        """Translation (px) since the first frame."""
        self.count += 1
        moved, _ = self.measured(self.now, frame, y_px, std_px)
        few = self.now["least"] is not None and np.mean(self.now["matches"][-AVERAGE:]) <= self.now["least"]
        if few and self.count - self.now["since"] > AFTER:
            moved = self.renewed(frame, y_px, std_px, moved)
        if np.isfinite(moved):
            self.last = frame, moved, self.count
        return moved

    def renewed(self, frame, y_px, std_px, moved):
        """Case 3: the frame before becomes the reference, at its own place."""
        frame_before, place_px, number = self.last
        region = Region(ROI.x, ROI.y + round(place_px), ROI.width, ROI.height)
        new = {**self.take(frame_before, region, place_px), "since": number}
        again, found = self.measured(new, frame, y_px, std_px)
        if found.status is not Status.TRACKING:
            return moved
        self.now, self.updates = new, self.updates + 1
        return again


def test_the_whole_system_is_the_papers_steps_in_plain_numpy(estimated):
    folder, table, reported = estimated
    time, value = np.genfromtxt(folder / "accel.csv", delimiter=",", skip_header=1).T
    # Section 2.1.1: the range in 256 grey levels.
    levels = (np.load(folder / "infrared.npz")["celsius"] - COLDEST_C) / KELVIN_PER_LEVEL
    grey = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    frames = [Frame(round(1e9 * at), one, k) for k, (at, one) in enumerate(zip(CASE.met_s, grey, strict=True))]
    known = frames[: np.count_nonzero(CASE.met_s < CALIBRATED_S[1])]
    matcher = Updating(frames[0])
    px, met = np.array([matcher.push(frame) for frame in known]), CASE.met_s[: len(known)]
    early = time < CALIBRATED_S[1]
    felt = time[early], value[early]
    offset_s, scale = printed_calibration(felt, (met, px), (0.3, 2.0), 0.5, sampled_first=False)
    infrared = reported["calibration"]["infrared"]
    assert infrared["scale_mm_per_px"] == pytest.approx(1e3 * scale, rel=0.01)
    assert infrared["time_offset_s"] == pytest.approx(offset_s, abs=1e-3)
    updating = Updating(frames[0])

    def measure(frame):
        def displacement(state, covariance):
            # In the calibration nothing predicts yet.
            if frame.index < len(known):
                return scale * updating.push(frame)
            std_px = np.sqrt(max(covariance[0, 0], 0.0)) / abs(scale)
            return scale * updating.push(frame, state[0] / scale, std_px)

        return displacement

    met_by = [(at + offset_s, measure(frame)) for at, frame in zip(CASE.met_s, frames, strict=True)]
    start = int(np.argmax(time >= met_by[0][0])) - 1
    # Equations 3 to 9 are those of the AMKF paper; the bias is known beforehand.
    states, _, _ = adaptive_kalman(
        time[start:], value[start:] - CASE.bias_m_s2, 4e-6, met_by, 0.95, begun=(0.25e-6, 0.05**2)
    )
    renewed_s = [event["time_s"] for event in reported["events"] if event["kind"] == "reference"]
    assert len(renewed_s) == updating.updates > 3
    expected = 1e3 * np.interp(table["time_s"], time[start:], states[:, 0])
    difference, at_s = table["displacement_mm"] - expected, table["time_s"]
    first = (at_s > at_s[0] + 1.0) & (at_s < renewed_s[0])
    assert np.std(difference[first]) < 0.01 * np.std(expected[first])
    # Each new reference keeps the error of its place; the printed filter predicts in both, so that they agree.
    assert np.std(difference[100:]) < 0.01 * np.std(expected)


def test_the_whole_system_is_as_near_to_the_truth_as_published(estimated):
    _, table, _ = estimated
    error = (table["displacement_mm"] - CASE.from_zero_mm(table["time_s"]))[100:]
    # Section 3.2: below 0.89 mm with references replaced.
    assert np.std(error) < 0.89


def test_without_updates_the_pattern_is_lost(estimated):
    folder, _, _ = estimated
    celsius = np.load(folder / "infrared.npz")["celsius"]
    last = Frame(0, celsius[-1], 0)
    first = open_tracker("template", replace(last, pixels=celsius[0]), ROI)
    assert first.push(last).status is Status.LOST
