"""Each break of `midspan simulate --break` does what it says, by how much it says, and leaves the truth alone."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from midspan.errors import UsageError
from midspan.simulate.motion.motion import Rest, Sines
from midspan.simulate.scenarios.breaks import BREAKS, broken
from midspan.simulate.scenarios.stage import stage
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write

FITS = {"tilt": "building", "pattern": "day-and-night", "interference": "radar-footbridge"}
FITS |= dict.fromkeys(("bracket", "mast", "breathing", "haze"), "footbridge")


def staged(*breaks, name="gnss", seed=5, **changes):
    """A scenario of a seed after its breaks, and what they drew; it may be changed first."""
    return broken(stage(replace(SCENARIOS[name], **changes), seed), name, breaks, SCENARIOS)


def pair(attribute, *breaks, **options):
    """What a sensor writes with the breaks and without them, noise being the same, and what the breaks drew."""
    (with_breaks, facts), (without, _) = staged(*breaks, **options), staged(**options)
    if attribute == "acceleration":
        return with_breaks.acceleration().value, without.acceleration().value, facts
    both = [one.displacement(one.scenario.gnss).value for one in (with_breaks, without)]
    return *both, facts


def true_acceleration(name, seed=5):
    one, _ = staged(name=name, seed=seed)
    return one.motion.acceleration(np.arange(round(one.scenario.duration_s * one.accelerometer.rate_hz)) /
                                   one.accelerometer.rate_hz)  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_gain_scales_the_acceleration_and_neither_bias_nor_noise(seed):
    with_gain, without, facts = pair("acceleration", "gain", seed=seed)
    true = true_acceleration("gnss", seed)
    assert 0.02 <= abs(facts["gain"]["gain"] - 1) <= 0.10
    # The only rounding is that of double precision.
    np.testing.assert_allclose(with_gain - without, (facts["gain"]["gain"] - 1) * true, atol=1e-12)


def test_axis_keeps_the_cosine_and_adds_the_sine_of_a_motion_that_is_as_strong():
    turned, without, facts = pair("acceleration", "axis", name="footbridge")
    true = true_acceleration("footbridge")
    angle = np.radians(facts["axis"]["angle_deg"])
    assert 3 <= facts["axis"]["angle_deg"] <= 15
    cross = (turned - without - (np.cos(angle) - 1) * true) / np.sin(angle)
    # The cross motion's size was set at 20 Hz over the same minute: equal but for that sampling, some per cent.
    assert np.std(cross) == pytest.approx(np.std(true), rel=0.05)
    # Other sines, other phases: 240 of them over a minute leave a correlation of about 1/sqrt(240).
    assert abs(np.corrcoef(cross, true)[0, 1]) < 0.2


def test_tilt_lets_gravity_follow_the_displacement():
    leaning, without, facts = pair("acceleration", "tilt", name="building")
    one, _ = staged(name="building")
    true = one.motion.displacement(np.arange(len(without)) / one.accelerometer.rate_hz)
    slope = facts["tilt"]["slope_per_m"]
    # 1.38 / height of 30 to 100 m.
    assert 0.0138 <= slope <= 0.046
    # At rest for a second, so that no constant is hidden in it.
    np.testing.assert_allclose(leaning - without, -9.80665 * slope * true, atol=1e-12)
    seen = staged("tilt", name="building")[0].sensed.displacement(np.arange(0, 600, 0.5))
    moved = seen - one.motion.displacement(np.arange(0, 600, 0.5))
    # The camera's own tilt times 10 m: 12 sines over ten minutes keep their rms to some ten per cent.
    assert np.std(moved) == pytest.approx(10 * np.radians(1e-3 * facts["tilt"]["camera_tilt_std_mdeg"]), rel=0.2)


@pytest.mark.parametrize("seed", range(3))
def test_logger_delays_and_droops_as_an_analogue_butterworth_filter(seed):
    hz, motion = 4.1, Sines([2e-3], [4.1])
    noiseless = replace(SCENARIOS["footbridge"].accelerometer, noise_std_m_s2=0.0, bias_m_s2=0.0)
    options = {"name": "footbridge", "motion": lambda rng: motion, "accelerometer": noiseless, "seed": seed}
    late, without, facts = pair("acceleration", "logger", **options)
    corner, order = facts["logger"]["corner_hz"], int(facts["logger"]["order"])
    poles = np.exp(1j * np.pi * (2 * np.arange(1, order + 1) + order - 1) / (2 * order))
    response = np.prod(-poles / (1j * hz / corner - poles))
    tone = np.exp(-2j * np.pi * hz * np.arange(500, 6000) / 100.0)
    # 5500 samples hold 225.5 periods: the other half of the tone leaks by 1/1400 of the amplitude.
    assert (late[500:] @ tone) / (without[500:] @ tone) == pytest.approx(response, abs=3e-3)
    assert 5 <= corner <= 12


@pytest.mark.parametrize("seed", range(4))
def test_bracket_vibrates_above_the_nyquist_frequency_of_the_frames(seed):
    one, facts = staged("bracket", name="footbridge", seed=seed)
    time = np.arange(0, 60, 0.004)
    shake = one.sensed.displacement(time) - one.motion.displacement(time)
    power = np.abs(np.fft.rfft(shake * np.hanning(len(shake)))) ** 2
    f = np.fft.rfftfreq(len(shake), 0.004)
    # A Hann window over a minute leaks less than a millionth beyond 0.5 Hz.
    assert power[f > 5.0].sum() > 0.9999 * power.sum()
    share = 1e-3 * facts["bracket"]["std_mm"] / np.std(one.motion.displacement(time))
    assert 0.045 <= share <= 0.16  # 5 to 15 %, the motion's size being sampled elsewhere
    # Its 40 sines repeat after some minutes; a tenth of an hour shows nearly their whole power.
    long = np.arange(0, 360, 0.011)
    shake = one.sensed.displacement(long) - one.motion.displacement(long)
    assert np.std(shake) == pytest.approx(1e-3 * facts["bracket"]["std_mm"], rel=0.05)
    np.testing.assert_array_equal(one.sensed.acceleration(time), one.motion.acceleration(time))


def test_exposure_averages_the_slow_sensor():
    hz, motion = 0.45, Sines([5e-3], [0.45])
    quiet = replace(SCENARIOS["gnss"].gnss.sensor, noise_std_m=0.0)
    options = {"motion": lambda rng: motion, "gnss": replace(SCENARIOS["gnss"].gnss, sensor=quiet)}
    averaged, without, facts = pair("displacement", "exposure", **options)
    assert 0.5 <= facts["exposure"]["exposure_s"] <= 0.9
    known = np.isfinite(without)
    # The mean of a sine over an exposure; a rule of five points is exact to 1e-7 at 0.4 periods.
    expected = np.sinc(hz * facts["exposure"]["exposure_s"]) * without[known]
    np.testing.assert_allclose(averaged[known], expected, atol=1e-8)


def test_colour_is_a_gauss_markov_process():
    # 300 correlation times or more of a long recording at rest: its figures are known to some six per cent.
    options = {"motion": lambda rng: Rest(), "duration_s": 20_000.0}
    coloured, white, facts = pair("displacement", "colour", **options)
    error = (coloured - white)[np.isfinite(white)]
    std, tau = 1e-3 * facts["colour"]["std_mm"], facts["colour"]["time_s"]
    assert 5 <= tau <= 60
    assert 1 <= std / 2e-3 <= 3
    assert np.std(error) == pytest.approx(std, rel=0.2)
    lag = round(tau)
    assert np.corrcoef(error[:-lag], error[lag:])[0, 1] == pytest.approx(np.exp(-lag / tau), abs=0.2)


@pytest.mark.parametrize("seed", range(4))
def test_step_shifts_the_level_and_stays(seed):
    shifted, without, facts = pair("displacement", "step", seed=seed)
    time = staged()[0].displacement(SCENARIOS["gnss"].gnss).time_ns / 1e9
    drawn = facts["step"]
    count = len(drawn) // 2
    sizes = np.array([drawn[f"mm_{k}"] for k in range(count)])
    assert np.all((np.abs(sizes) >= 6) & (np.abs(sizes) <= 40))  # 3 to 20 times 2 mm
    expected = sum(1e-3 * size * (time >= drawn[f"at_s_{k}"]) for k, size in enumerate(sizes))
    known = np.isfinite(without)
    np.testing.assert_allclose((shifted - without)[known], expected[known], atol=1e-12)


def test_burst_is_ten_times_the_noise_for_its_share_of_the_time():
    options = {"motion": lambda rng: Rest(), "duration_s": 20_000.0}
    loud, quiet, facts = pair("displacement", "burst", **options)
    changed = (loud != quiet) & np.isfinite(quiet)
    assert np.mean(changed) == pytest.approx(facts["burst"]["share"], abs=0.01)  # sampled once a second
    assert 0.10 <= facts["burst"]["share"] <= 0.21  # the last span may end beyond a fifth
    # Some 3000 values: their spread is known to 1.3 %.
    assert np.std(loud[changed]) == pytest.approx(10 * 2e-3, rel=0.05)
    # In spans: a changed value has a changed neighbour nearly always.
    assert np.mean(changed[1:][changed[:-1]]) > 0.8


def test_pattern_sets_the_fixed_pattern_and_nothing_else():
    one, facts = staged("pattern", name="day-and-night")
    assert facts == {"pattern": {"pattern_k": 0.1}}
    day = SCENARIOS["day-and-night"].day
    assert one.scenario.day == replace(day, thermal=replace(day.thermal, pattern_k=0.1))


@pytest.mark.parametrize("seed", range(3))
def test_a_mast_nods_at_its_frequency_and_the_accelerometer_feels_nothing(seed):
    one, facts = staged("mast", name="footbridge", seed=seed)
    time, drawn = np.arange(0, 6000, 0.2), facts["mast"]
    nod = one.sensed.displacement(time) - one.motion.displacement(time)
    # 36 to 180 times the inverse of its width: its power is known to a tenth or two.
    assert np.std(nod) == pytest.approx(1e-3 * drawn["std_mm"], rel=0.15)
    assert np.mean(nod[1:] * nod[:-1] < 0) / 0.2 / 2 == pytest.approx(drawn["frequency_hz"], rel=0.05)
    assert 0.1 <= drawn["frequency_hz"] <= 0.5
    np.testing.assert_array_equal(one.sensed.acceleration(time), one.motion.acceleration(time))


def test_a_lens_that_breathes_moves_what_is_beside_its_axis():
    small = replace(SCENARIOS["footbridge"].camera, size_px=(64, 64), light=None)
    one, facts = staged("breathing", name="footbridge", camera=small, motion=lambda rng: Rest())
    setup, share = one.scenario.camera, facts["breathing"]["share"]
    (breathing,) = setup.disturbances(np.random.default_rng(0))
    times = np.arange(0.0, 60.0, 0.5)
    assert np.std(breathing.grown(times)) == pytest.approx(share, rel=0.5)
    plain, at = staged(name="footbridge", camera=small, motion=lambda rng: Rest())[0].view(small), times[10]
    still, hit = plain.mean_image(one.motion, at), one.view(setup).mean_image(one.motion, at)
    # By first order the picture moves by the growth times the distance from the axis.
    down = np.gradient(still, axis=0)[8:-8, 8:-8]
    moved = -np.sum(down * (hit - still)[8:-8, 8:-8]) / np.sum(down**2)
    away = 31.5 - breathing.middle_px[1]
    assert moved == pytest.approx(breathing.grown(np.array([at]))[0] * away, rel=0.15)


def test_haze_is_a_gauss_markov_process_of_the_picture():
    one, facts = staged("haze", name="footbridge", duration_s=4000.0)
    time, drawn = np.arange(0, 4000.0, 0.1), facts["haze"]
    error = one.sensed.displacement(time) - one.motion.displacement(time)
    assert np.std(error) / 1.5e-3 == pytest.approx(drawn["std_px"], rel=0.15)
    lag = round(10 * drawn["time_s"])
    assert np.corrcoef(error[:-lag], error[lag:])[0, 1] == pytest.approx(np.exp(-1), abs=0.1)


def test_an_rtk_receiver_converges_and_is_fixed_again():
    off, right, facts = pair("displacement", "float")
    time, drawn = staged()[0].displacement(SCENARIOS["gnss"].gnss).time_ns / 1e9, facts["float"]
    age, known = time - drawn["at_s"], np.isfinite(right)
    expected = np.where((age >= 0) & (age < 40), 1e-3 * drawn["mm"] * np.exp(-age / 25), 0.0)
    assert 60 <= abs(drawn["mm"]) <= 100
    np.testing.assert_allclose((off - right)[known], expected[known], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_a_clock_that_is_set_moves_the_stamps_and_no_value(seed):
    one, facts = staged("clock-step", name="footbridge", seed=seed)
    setup, drawn = one.scenario.camera, facts["clock-step"]
    true = one.frame_stamps_s(setup) + setup.time_offset_s
    ahead = one.written_stamps_s(setup) - one.frame_stamps_s(setup)
    np.testing.assert_allclose(ahead, np.where(true >= drawn["at_s"], drawn["step_s"], 0.0), atol=1e-12)
    assert np.all(np.diff(one.written_stamps_s(setup)) > 0)
    late, plain, facts = pair("displacement", "clock-step", seed=seed)
    np.testing.assert_array_equal(late, plain)
    hit = staged("clock-step", seed=seed)[0]
    series = hit.displacement(hit.scenario.gnss)
    assert abs(facts["clock-step"]["step_s"]) in (0.02, 0.06, 0.3)
    assert len(series.time_ns) == len(plain)
    before = staged(seed=seed)[0].displacement(SCENARIOS["gnss"].gnss).time_ns
    assert set(series.time_ns - before) == {0, round(1e9 * facts["clock-step"]["step_s"])}


@pytest.mark.parametrize("seed", range(3))
def test_a_railing_amplifies_as_its_resonance_does(seed):
    hz, motion = 4.1, Sines([2e-3], [4.1])
    noiseless = replace(SCENARIOS["footbridge"].accelerometer, noise_std_m_s2=0.0, bias_m_s2=0.0)
    options = {"name": "footbridge", "motion": lambda rng: motion, "accelerometer": noiseless, "seed": seed}
    top, foot, facts = pair("acceleration", "railing", **options)
    resonance, damping = facts["railing"]["frequency_hz"], facts["railing"]["damping"]
    assert 6 <= resonance <= 12
    r = hz / resonance
    response = (1 + 2j * damping * r) / (1 - r * r + 2j * damping * r)
    tone = np.exp(-2j * np.pi * hz * np.arange(1500, 6000) / 100.0)
    # Its own vibration has decayed to less than a hundredth; the bilinear rule bends the resonance by 0.2 %.
    assert abs((top[1500:] @ tone) / (foot[1500:] @ tone)) == pytest.approx(abs(response), rel=0.02)


def test_hum_is_a_line_that_only_the_accelerometer_has():
    hums, quiet, facts = pair("acceleration", "hum", name="footbridge")
    drawn, added = facts["hum"], hums - quiet
    power = np.abs(np.fft.rfft(added * np.hanning(len(added)))) ** 2
    f = np.fft.rfftfreq(len(added), 0.01)
    assert f[np.argmax(power)] == pytest.approx(drawn["shows_hz"], abs=1 / 60)
    assert np.std(added) == pytest.approx(drawn["amplitude_m_s2"] / np.sqrt(2), rel=0.05)
    assert abs(drawn["machine_hz"] - 100 * round(drawn["machine_hz"] / 100)) == pytest.approx(drawn["shows_hz"])


def test_rounded_stamps_come_in_threes_around_the_middle_one():
    one, facts = staged("rounding", name="footbridge")
    time_ns = one.acceleration().time_ns
    assert facts["rounding"]["step_s"] == 0.03
    np.testing.assert_array_equal(time_ns[3:-3:3], time_ns[2:-4:3])
    np.testing.assert_array_equal(time_ns[3:-3:3], time_ns[4:-2:3])
    np.testing.assert_array_equal(time_ns[::3], 10_000_000 * np.arange(0, len(time_ns), 3))


def test_interference_is_in_every_bin_and_stronger_than_the_target():
    one, facts = staged("interference", name="radar-slow-time", duration_s=20.0)
    plain, _ = staged(name="radar-slow-time", duration_s=20.0)
    models = [each.scenario.radar.model(np.random.default_rng(1)) for each in (one, plain)]
    hit, quiet = (np.concatenate(list(model.blocks(one.motion, 300, rng=np.random.default_rng(2)))) for model in models)
    time = models[0].frame_s(300) + models[0].time_offset_s
    jammed = np.any([(time >= a) & (time < b) for a, b in one.scenario.radar.jammed], axis=0)
    assert 0 < np.sum(jammed) < 300
    differs = np.any(hit != quiet, axis=(1, 2, 3))
    assert np.mean(differs != jammed) < 0.02  # a burst may begin within a frame
    # The mean over a chirp's samples is any one bin; 6 dB above 900 counts.
    inside = np.abs(np.mean(hit[differs], axis=(1, 3)))
    assert np.sqrt(np.mean(inside**2)) == pytest.approx(2 * 900, rel=0.4)
    assert facts["interference"]["above_target_db"] == 6.0


@pytest.mark.parametrize("name", BREAKS)
def test_a_break_follows_from_the_seed_alone_and_leaves_the_truth(name):
    scenario = FITS.get(name, "gnss")
    (one, facts), (again, same) = staged(name, name=scenario), staged(name, name=scenario)
    plain, nothing = staged(name=scenario)
    assert facts == same
    assert nothing == {}
    assert staged(name, name=scenario, seed=6)[1] != facts or name in ("pattern", "rounding")
    np.testing.assert_array_equal(one.truth_mm(), plain.truth_mm())
    np.testing.assert_array_equal(one.acceleration().value, again.acceleration().value)


def test_breaks_add_up_and_do_not_change_each_other():
    both, facts = staged("step", "gain", "logger")
    assert facts["gain"] == staged("gain")[1]["gain"]
    assert facts["step"] == staged("step", "colour")[1]["step"]
    turned, _ = staged("logger", "step", "gain")
    np.testing.assert_array_equal(both.acceleration().value, turned.acceleration().value)


def test_a_break_that_does_not_fit_is_refused_with_the_scenarios_that_it_fits(tmp_path):
    with pytest.raises(UsageError, match=r"--break tilt does not fit 'gnss'.*It fits building, radar-tall-building"):
        write("gnss", tmp_path / "a", breaks=["tilt"])
    with pytest.raises(UsageError, match=r"received 'collour'\. Did you mean 'colour'"):
        write("gnss", tmp_path / "a", breaks=["collour"])
    assert not (tmp_path / "a").exists()


def test_a_broken_camera_does_not_say_its_exposure_and_its_truth_is_that_of_the_whole_one(tmp_path, monkeypatch):
    base = SCENARIOS["footbridge"]
    small = replace(base, duration_s=8.0, camera=replace(base.camera, size_px=(48, 48)))
    monkeypatch.setitem(SCENARIOS, "footbridge", small)
    whole, hit = (write("footbridge", tmp_path / str(k), breaks=b) for k, b in enumerate(([], ["exposure", "gain"])))
    assert (whole / "truth.csv").read_bytes() == (hit / "truth.csv").read_bytes()
    assert (whole / "camera.mkv").read_bytes() != (hit / "camera.mkv").read_bytes()
    settings = [tomllib.loads((folder / "recording.toml").read_text())["camera"] for folder in (whole, hit)]
    assert settings[0].pop("exposure_s") == 0.004
    assert settings[0] == settings[1]
    assert "broken" not in json.loads((whole / "known.json").read_text())
    drawn = json.loads((hit / "known.json").read_text())["broken"]
    assert 0.05 <= drawn["exposure"]["exposure_s"] <= 0.09  # 50 to 90 % of a tenth of a second
    assert set(drawn) == {"exposure", "gain"}
