"""The recordings with a radar: files that open, phases that are the truth's, blockages and losses where they belong."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from midspan.radar.layout import Layout, pack
from midspan.radar.range_profile import slow_time
from midspan.simulate.motion.motion import Sines
from midspan.simulate.radar.setup import NEAR, RadarSetup, setup_lost, write_slow_time
from midspan.simulate.radar.signal import RadarModel, Reflector
from midspan.simulate.scenarios.radar import LORRY, RADAR_SCENARIOS, VAN
from midspan.simulate.scenarios.stage import stage
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest

LARGEST_BYTES = 40_000_000


def table(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def opened(folder):
    """The radar of a recording, as its settings say, and what an estimate should find."""
    said = tomllib.loads((folder / "recording.toml").read_text())["radar"]
    config = folder / said["config"] if "config" in said else None
    request = RadarRequest(config=config, start_s=said.get("start_s", 0.0))
    return open_radar(folder / said["file"], request), json.loads((folder / "known.json").read_text())["radar"]


def phasors(source, range_m):
    """Phasors (frames, channels) and valid (frames, channels) at a range."""
    place = np.interp(range_m, source.info.range_m, np.arange(source.info.bins))
    blocks = list(source.slow_time(np.array([place])))
    return np.concatenate([b.phasors[..., 0] for b in blocks]), np.concatenate([b.valid for b in blocks])


@pytest.fixture
def short(monkeypatch, tmp_path):
    """Writes the first seconds of a scenario; returns its folder."""

    def put(name, duration_s=8.0, seed=0):
        monkeypatch.setitem(SCENARIOS, name, replace(SCENARIOS[name], duration_s=duration_s))
        return write(name, tmp_path / f"{name}-{seed}", seed=seed)

    return put


@pytest.mark.parametrize("name", RADAR_SCENARIOS)
def test_the_radars_frames_lie_within_the_acceleration_and_the_truth_begins_at_the_first(short, name):
    folder = short(name)
    source, known = opened(folder)
    truth, acceleration = table(folder / "truth.csv"), table(folder / "accel.csv")
    true_s = source.times_ns() / 1e9 + known["time_offset_s"]
    assert acceleration["time_s"][0] <= true_s[0]
    assert true_s[-1] <= acceleration["time_s"][-1]
    assert abs(known["time_offset_s"]) < 0.5  # the largest offset that calibration searches for on its own
    assert not source.info.warnings
    if SCENARIOS[name].camera is None:
        # The first frame lies on a sample, or between two in lively motion: a cubic meets 4 mm at 3 Hz to 2e-4 mm.
        curve = CubicSpline(truth["time_s"], truth["displacement_mm"])
        assert curve(true_s[0]) == pytest.approx(0.0, abs=1e-6 if true_s[0] in truth["time_s"] else 5e-4)


@pytest.mark.parametrize("name", RADAR_SCENARIOS)
@pytest.mark.parametrize("seed", [0, 7])
def test_no_recording_is_larger_than_forty_megabytes_and_targets_stay_within_a_bin(name, seed):
    scenario = RADAR_SCENARIOS[name]
    setup, staged = scenario.radar, stage(scenario, seed)
    words = setup.targets * setup.profile.receivers * 4 if setup.slow_time else Layout(setup.profile).frame_words
    assert 2 * words * setup.frames(scenario.duration_s) < LARGEST_BYTES
    reflectors = setup.reflectors(np.random.default_rng(seed))
    moved_m = 1e-3 * np.ptp(staged.truth_mm()[:, 1])
    assert moved_m * max(abs(r.ratio) for r in reflectors[: setup.targets]) < setup.profile.bin_m


@pytest.mark.parametrize("name", ["radar-footbridge", "radar-slow-time"])
def test_the_unwrapped_phase_times_the_factor_is_the_truth(short, name):
    folder = short(name, 12.0, seed=3)
    source, known = opened(folder)
    truth, target = table(folder / "truth.csv"), known["targets"][0]
    z, valid = phasors(source, target["range_m"])
    assert valid.all()
    # Channels in phase with the first, then the nearest cycle: both scenarios are slower than the limit.
    z = (z * np.exp(-1j * np.angle(np.mean(z * z[:, :1].conj(), axis=0)))).mean(axis=1)
    moved = np.unwrap(np.angle(z)) / source.info.axis.phase_per_m(target["range_m"])
    value = 1e3 * target["conversion_factor"] * (moved - moved[0])
    true_s = source.times_ns() / 1e9 + known["time_offset_s"]
    error = value - np.interp(true_s, truth["time_s"], truth["displacement_mm"])
    assert truth["displacement_mm"].std() > 0.5
    # The Hann window costs 1.22, a place between two stored bins a little more. The bracket in the footbridge's bin is
    # 0.056 of the target there: 0.04 rad rms of 3.3 rad/mm, 0.015 mm with the factor of 1.27.
    assert error.std() < 1.5 * target["cramer_rao_std_mm"] + (0.015 if name == "radar-footbridge" else 0.0)
    assert error.std() > 0.9 * target["cramer_rao_std_mm"]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_tall_building_is_faster_than_plain_unwrapping_and_comes_nearer_as_it_moves_forward(seed):
    scenario = RADAR_SCENARIOS["radar-tall-building"]
    truth = stage(scenario, seed).truth_mm()
    assert np.ptp(truth[:, 1]) > 80.0
    facade = scenario.radar.reflectors(np.random.default_rng(0))[0]
    assert np.abs(facade.ratio * truth[:, 2]).max() > 1.2e3 * scenario.radar.profile.limit_speed_m_s
    assert facade.ratio < 0


def test_blocked_targets_vanish_and_come_back_and_lost_packets_are_holes(tmp_path):
    folder = write("radar-blockage", tmp_path / "b")
    source, known = opened(folder)
    true_s = source.times_ns() / 1e9 + known["time_offset_s"]
    lorry, van = ((true_s >= a) & (true_s < b) for a, b in (LORRY, VAN))
    for target, hidden in zip(known["targets"], (lorry | van, lorry | van, lorry), strict=True):
        z, valid = phasors(source, target["range_m"])
        whole = valid.all(axis=1)
        usual = np.median(np.abs(z[whole & ~hidden]))
        assert np.abs(z[whole & hidden]).max() < 0.4 * usual  # the limit of blockage
        assert np.abs(z[whole & ~hidden]).min() > 0.4 * usual
    lost = np.zeros(len(true_s), dtype=bool)
    for start, end in SCENARIOS["radar-blockage"].radar.lost:
        lost |= (true_s >= start - 0.01) & (true_s < end + 0.01)
    assert not whole[lost].all()
    assert whole[~lost].all()
    assert np.count_nonzero(~whole) == pytest.approx(34, abs=3)  # 0.34 s at 100 Hz


def test_lost_spans_are_whole_packets_of_the_frames_in_them():
    setup = RadarSetup(lambda rng: (Reflector(3.0, 900.0),), lost=((1.0, 1.1),), time_offset_s=0.0)
    # 10 frames of 1024 bytes from frame 100 on, in packets of 1456 bytes.
    assert setup_lost(setup, Layout(NEAR)) == tuple(range(70, 77))


def test_stored_phasors_are_those_of_the_raw_samples(tmp_path):
    model = RadarModel((Reflector(3.0, 900.0), Reflector(6.1, 400.0, -0.5)), NEAR, 50.0)
    cubes = list(model.blocks(Sines([1e-3], [2.0]), 700, rng=np.random.default_rng(0)))  # two blocks
    places = np.array([3.0, 6.1])
    write_slow_time(tmp_path / "radar.h5", iter(cubes), (NEAR, 700, places))
    source = open_radar(tmp_path / "radar.h5", RadarRequest())
    stored = np.concatenate([block.phasors for block in source.profiles()])
    assert stored.shape == (700, 2, 2)
    layout = Layout(NEAR, "IQIQ")
    raw = slow_time(pack(np.concatenate(cubes), layout), layout, places / NEAR.bin_m)
    # Raw words are rounded: 0.29 counts in I and Q, divided by the window's sqrt(128 / 1.5) = 9.2; 5 deviations.
    assert np.abs(stored - raw).max() < 5 * np.hypot(0.29, 0.29) / 9.2
    assert np.abs(stored[..., 0]).mean() == pytest.approx(900.0, rel=0.01)
    np.testing.assert_allclose(source.info.range_m, places)


def test_the_same_seed_writes_the_same_samples_and_another_seed_others(short):
    folder = short("radar-footbridge", 4.0, seed=1)
    kept = {name: (folder / name).read_bytes() for name in ("adc_data.bin", "radar.cfg", "accel.csv", "truth.csv")}
    again = short("radar-footbridge", 4.0, seed=1)  # its own folder may be written anew
    other = short("radar-footbridge", 4.0, seed=2)
    for name, data in kept.items():
        assert (again / name).read_bytes() == data
    assert (other / "radar.cfg").read_bytes() == kept["radar.cfg"]
    for name in ("adc_data.bin", "accel.csv", "truth.csv"):
        assert (other / name).read_bytes() != kept[name]


def test_progress_counts_frames_up_to_all(tmp_path):
    setup, calls = RadarSetup(lambda rng: (Reflector(3.0, 900.0),)), []
    setup.write(
        tmp_path,
        Sines([1e-3], [2.0]),
        duration_s=12.0,
        rng=np.random.default_rng(0),
        progress=lambda done, total: calls.append((done, total)),
    )
    frames = setup.frames(12.0)
    assert [done for done, _ in calls] == [500, 1000, frames]
    assert {total for _, total in calls} == {frames}
