"""Natural frequencies and damping against oscillators whose answer to white force is exact."""

import json

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from midspan.cli.main import run
from midspan.errors import DataError
from midspan.evaluate.spectrum import spectrum
from midspan.records import TimeSeries, nanoseconds

RATE_HZ, MODES = 50.0, ((1.31, 0.010, 2.0), (3.7, 0.015, 0.5), (6.4, 0.008, 0.1))


def answered(hertz, damping, rms, count, rng, rate_hz=RATE_HZ):
    """Displacement (count,) of an oscillator under white force: its transition over a sample is exact."""
    omega, fine = 2.0 * np.pi * hertz, 8
    dt = 1.0 / (fine * rate_hz)
    step = expm(np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]]) * dt)
    force = rng.normal(0.0, 1.0, fine * (count + 4000))
    moved = lfilter([0.0, step[0, 1]], [1.0, -np.trace(step), np.linalg.det(step)], force)[4000 * fine :: fine]
    # By the variance that white force makes, not by that of the sample.
    free = lfilter([0.0, step[0, 1]], [1.0, -np.trace(step), np.linalg.det(step)], np.eye(1, 400_000)[0])
    return rms * moved / np.sqrt(np.sum(free**2))


def record(seed, length_s=600.0, noise_mm=0.01, modes=MODES):
    rng = np.random.default_rng(seed)
    count = int(length_s * RATE_HZ)
    value = sum(answered(*mode, count, rng) for mode in modes) + rng.normal(0.0, noise_mm, count)
    return TimeSeries(nanoseconds(np.arange(count) / RATE_HZ), 1e-3 * value)


def test_frequencies_and_damping_lie_within_their_deviations():
    z = []
    for seed in range(8):
        found = spectrum(record(seed)).modes
        assert len(found) == 3
        for mode, (hertz, damping, rms) in zip(found, MODES, strict=True):
            z.append((
                (mode.frequency_hz - hertz) / mode.frequency_std_hz,
                (mode.damping - damping) / mode.damping_std,
            ))  # fmt: skip
            assert mode.damping_std < 0.5 * damping
            # The variance of a narrow band over 600 s is known to 1/√(2π ζ f T): 15 % at 1.3 Hz; 4 of them.
            assert mode.rms_mm == pytest.approx(rms, rel=0.5)
    # 24 of each: an rms of 1 has a deviation of 0.14.
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < 1.6)
    assert np.max(np.abs(z)) < 4.5


@pytest.mark.parametrize("companions", [(), MODES[2:]], ids=["alone", "with a mode"])
def test_a_tone_is_listed_without_damping(companions):
    for seed in range(4):
        series, length_s = record(seed, 300.0, modes=companions), 300.0
        hertz, rms = 1.857 + 0.01 * seed, 1.2
        tone = rms * np.sqrt(2.0) * np.sin(2 * np.pi * hertz * np.arange(len(series.value)) / RATE_HZ)
        found = spectrum(TimeSeries(series.time_ns, series.value + 1e-3 * tone)).modes
        assert len(found) == 1 + len(companions)
        assert np.isnan(found[0].damping)
        assert abs(found[0].frequency_hz - hertz) < 1.0 / length_s
        # The taper of the record's ends is made up for on average only.
        assert found[0].rms_mm == pytest.approx(rms, rel=0.05)
        assert all(np.isfinite(mode.damping) for mode in found[1:])


def test_white_noise_has_no_mode():
    for seed in range(6):
        assert spectrum(record(seed, 300.0, noise_mm=1.0, modes=())).modes == ()


def test_a_short_record_is_refused():
    with pytest.raises(DataError, match="longer record"):
        spectrum(record(0, 5.0))


def test_the_command_prints_and_writes(tmp_path, capsys):
    series = record(1, 300.0)
    rows = np.column_stack((series.time_ns * 1e-9, 1e3 * series.value))
    np.savetxt(tmp_path / "result.csv", rows, "%.9f", ",", header="time_s,displacement_mm", comments="")
    target = tmp_path / "spectrum.csv"
    assert run(["spectrum", str(tmp_path / "result.csv"), "-o", str(target), "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [round(mode["frequency_hz"], 1) for mode in found["modes"]] == [1.3, 3.7, 6.4]
    frequency, density = np.loadtxt(target, delimiter=",", skiprows=1).T
    # Parseval: the spectrum holds the variance.
    assert np.sum(density) * frequency[1] == pytest.approx(np.var(rows[:, 1]), rel=0.2)
