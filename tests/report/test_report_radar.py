"""The report's section on the radar, and the thinned record that it draws on."""

import re
from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.engine.radar_target import FollowedTarget
from midspan.engine.radar_trace import MAX_SEGMENTS, RadarLog
from midspan.radar.target import Target
from midspan.records import Event, PhaseMeasurement, Status
from midspan.report.material import gather
from midspan.report.report import report_html
from midspan.simulate.radar.setup import NEAR
from midspan.simulate.scenarios.radar import RADAR_SCENARIOS
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write

RATE, UNIT = 100.0, NEAR.phase_per_m()
BLOCKED = (12.0, 14.0)
FIGURES = ["Range profile", "Circle of the phasors", "Phase, measured and unwrapped", "Targets over the record"]


def traced(speed_m_s, frames=4000, hidden=slice(0, 0), restarts=(), places=None):
    """The trace of a sine of 0.5 Hz with a largest speed, from time 5 s on, as if it had been unwrapped rightly."""
    places = np.arange(frames) if places is None else places
    phase = UNIT * speed_m_s / np.pi * np.sin(np.pi * places / RATE)
    strength = np.ones(len(places))
    strength[hidden], phase[hidden] = 0.05, np.nan
    target = Target(30.0, 3.0, 100.0, 30.0, np.ones(1, dtype=np.complex128), 0.0)
    log = RadarLog([FollowedTarget(target, UNIT, np.array([30.0]), np.nan, 1.0 / RATE)])
    for k, place in enumerate(places):
        time_ns = round(1e9 * (5.0 + place / RATE))
        status = Status.TRACKING if np.isfinite(phase[k]) else Status.COASTING
        # After a lost cycle the zero of the phase is another one.
        phase[k:] += 5.0 if k in restarts else 0.0
        events = (Event(time_ns, "new datum", "") if k in restarts else None,)
        log.push([PhaseMeasurement(time_ns, phase[k], 1e-4, 0.0, status, strength[k], tuple(filter(None, events)))])
    return log.trace(NEAR.limit_speed_m_s)


@pytest.mark.parametrize(("speed_m_s", "slips"), [(0.08, False), (0.15, True)])
def test_the_largest_speed_is_the_motions_and_plain_unwrapping_slips_beyond_the_limit_only(speed_m_s, slips):
    found = traced(speed_m_s)
    # Over 0.03 s the sine of 0.5 Hz loses (π 0.03 / 2)² / 6 = 0.04 % of its speed.
    assert found.speed_m_s == pytest.approx(speed_m_s, rel=1e-3)
    assert found.limit_speed_m_s == pytest.approx(0.0960, abs=1e-4)  # 78.077 GHz: a quarter of 3.84 mm in 0.01 s
    cut = found.excerpt
    assert (np.abs(cut.plain - cut.unwrapped).max() > 1.0) == slips
    np.testing.assert_allclose(np.angle(np.exp(1j * (cut.unwrapped - cut.wrapped))), 0.0, atol=1e-6)
    np.testing.assert_allclose(found.high.max(), UNIT * speed_m_s / np.pi, rtol=1e-3)


def test_a_blocked_segment_is_low_and_unused_and_its_end_is_reported_on_the_accelerometers_clock():
    found = traced(0.05, hidden=slice(1200, 1400), restarts=(1400,)).targets[0]
    t = found.time_ns / 1e9 - 5.0
    inside = (t >= BLOCKED[0]) & (t + 0.02 < BLOCKED[1])
    assert found.high[inside].max() == pytest.approx(0.05, abs=1e-6)
    assert found.used[inside].max() == 0.0
    outside = (t + 0.02 < BLOCKED[0]) | (t >= BLOCKED[1])
    assert found.used[outside].min() == 1.0
    np.testing.assert_allclose(found.low[outside], 1.0, atol=1e-6)
    assert found.restarts_ns.tolist() == [19_000_000_000]


def test_a_pause_or_a_cycle_found_anew_is_no_speed():
    places = np.concatenate((np.arange(1000), np.arange(1037, 2000)))
    assert traced(0.05, places=places).speed_m_s == pytest.approx(0.05, rel=1e-3)
    # A frame after which the zero is another one lies anywhere: the step to it must not count.
    assert traced(0.05, frames=1000, restarts=(500,)).speed_m_s == pytest.approx(0.05, rel=1e-3)


def test_a_long_record_is_kept_in_few_numbers():
    found = traced(0.05, frames=30_000)
    assert MAX_SEGMENTS / 2 <= len(found.low) == len(found.targets[0].used) <= MAX_SEGMENTS
    assert len(found.excerpt.time_ns) == pytest.approx(250, abs=1)
    # Nothing is lost of what the segments hold.
    np.testing.assert_allclose(found.high.max(), UNIT * 0.05 / np.pi, rtol=1e-3)
    assert found.targets[0].time_ns[[0, -1]] == pytest.approx([5.0e9, 305.0e9], abs=0.2e9)


@pytest.fixture(name="result", scope="module")
def result_of_a_short_recording(tmp_path_factory):
    """Twenty seconds of the blocked footbridge, with everything hidden earlier."""
    base = RADAR_SCENARIOS["radar-blockage"]

    def view(rng):
        wall = base.radar.reflectors(rng)[0]
        return (replace(wall, blocked=(BLOCKED,)), base.radar.reflectors(rng)[3])

    with pytest.MonkeyPatch.context() as patch:
        radar = replace(base.radar, reflectors=view, targets=1, lost=())
        short = replace(base, duration_s=20.0, window_s=(0.0, 11.5), radar=radar)
        patch.setitem(SCENARIOS, "radar-blockage", short)
        folder = write("radar-blockage", tmp_path_factory.mktemp("radar") / "site", seed=2)
    return midspan.estimate(midspan.open_recording(folder))


def figures(text):
    """Titles of the pictures in the section on the radar."""
    found = re.search(r'<section id="radar">.*?</section>', text, re.DOTALL)
    return re.findall(r'<img alt="([^"]*)"', found[0]) if found else None


def test_the_section_shows_the_profile_the_targets_the_circle_and_the_phase(result):
    text = report_html(result, result.recording.reference)
    assert figures(text) == FIGURES
    section = re.search(r'<section id="radar">.*?</section>', text, re.DOTALL)[0]
    best = result.calibration.radar.best
    assert best.conversion_factor == pytest.approx(1.06, abs=5 * best.conversion_factor_std)
    assert f"{best.conversion_factor:.5f}\u00a0±\u00a0{best.conversion_factor_std:.5f}" in section
    assert "used, rank 1" in section
    assert section.count("does not follow the accelerometer") == 1  # the leakage
    truth_mm_s = np.abs(
        np.genfromtxt(result.recording.folder / "truth.csv", delimiter=",", names=True)["velocity_mm_s"]
    )
    reported = float(re.search(r"at most ([\d.]+) mm/s", section)[1])
    # The largest speed over 0.03 s with the phase's noise of 0.02 rad: 0.3 mm/s.
    assert reported == pytest.approx(truth_mm_s.max() / 1.06, rel=0.1)


def test_the_radars_own_measurements_are_drawn_and_blocked_frames_are_not(result):
    measured = gather(result, None).measured
    assert [one.name for one in measured] == ["radar"]
    t = measured[0].time_ns / 1e9
    hidden = (t >= BLOCKED[0]) & (t < BLOCKED[1])
    assert np.isnan(measured[0].value_mm[hidden]).all()
    assert np.isnan(measured[0].std_mm[hidden]).all()
    assert np.isfinite(measured[0].value_mm[~hidden]).mean() > 0.98  # a few frames after it count as blocked
    assert measured[0].rate_hz == pytest.approx(100.0)


@pytest.mark.usefixtures("undrawn")
def test_a_calibration_from_a_file_has_its_table_but_not_what_it_rests_on(result, tmp_path):
    loaded = midspan.load_calibration(result.calibration.save(tmp_path / "calibration.json"))
    again = midspan.estimate(result.recording, calibration=loaded)
    assert figures(report_html(again)) == FIGURES[2:]


def test_targets_of_unknown_range_are_named_by_their_bin(result):
    radar = result.calibration.radar
    known = [replace(item, target=replace(item.target, range_m=np.nan)) for item in radar.targets]
    blind = replace(radar.diagnostics, range_m=np.full_like(radar.diagnostics.range_m, np.nan))
    nameless = replace(radar, targets=tuple(known), diagnostics=blind)
    text = report_html(replace(result, calibration=replace(result.calibration, radar=nameless)))
    assert figures(text) == FIGURES
    assert f"in bin {radar.best.place_bin:.1f}" in text
    assert "nan" not in re.sub(
        r'src="data:[^"]*"', "", re.search(r'<section id="radar">.*?</section>', text, re.DOTALL)[0]
    )
