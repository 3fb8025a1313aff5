"""Time stamps that a logger rounded, rows that came twice, thousandths behind a colon."""

from pathlib import Path

import numpy as np
import pytest

from midspan.errors import DataError
from midspan.records import TimeSeries
from midspan.sources.accelerometer.select import SeriesRequest, read_series

RNG = np.random.default_rng(16)


def series_of(path: Path, time_s: np.ndarray, *columns: np.ndarray, decimals: int = 3, value: str = "a0") -> TimeSeries:
    names = ["time_s", *(f"a{k}" for k in range(len(columns)))]
    rows = (f"{t:.{decimals}f}," + ",".join(f"{v:.6f}" for v in values) for t, *values in zip(time_s, *columns))  # noqa: B905
    path.write_text(",".join(names) + "\n" + "\n".join(rows) + "\n")
    return read_series(path, SeriesRequest("acceleration", value=value, unit="m/s^2"))


def error_s(series: TimeSeries, true_s: np.ndarray) -> float:
    """The largest error of the stamps but for a common offset, which a clock has anyway."""
    late = series.time_ns * 1e-9 - true_s
    return float(np.ptp(late)) / 2.0


@pytest.mark.parametrize("rate_hz", [102.4, 199.7, 1024.0])
@pytest.mark.parametrize("rounded", [np.rint, np.floor])
def test_stamps_of_an_even_clock_rounded_to_10_ms_are_put_back(
    tmp_path: Path, rate_hz: float, rounded: np.ufunc
) -> None:
    true_s = 0.0137 + np.arange(3000) / rate_hz
    series = series_of(tmp_path / "a.csv", rounded(true_s / 0.01) * 0.01, RNG.standard_normal(3000), decimals=2)
    # What 3000 rounded stamps tell of an even clock: a few thousandths of the rounding (10 ms).
    assert error_s(series, true_s) < 0.1e-3
    (notice,) = series.notices
    assert notice.code == "stamps-corrected"
    assert "rounded to 10 ms; they were spread within the rounding; all rows fit evenly spaced times" in notice


def test_lost_samples_and_a_jittery_clock_stay_within_the_rounding(tmp_path: Path) -> None:
    even_s = np.arange(3000) / 199.7
    for name, true_s in {
        "lost": even_s[RNG.random(3000) > 0.003],
        "jitter": np.sort(even_s + RNG.normal(0.0, 0.001, 3000)),
    }.items():
        series = series_of(tmp_path / f"{name}.csv", true_s, RNG.standard_normal(len(true_s)), decimals=2)
        assert np.all(np.diff(series.time_ns) > 0)
        # The rounding is 10 ms, and a fit may be off by a twentieth of it more.
        assert np.abs(series.time_ns * 1e-9 - true_s).max() < 0.0105 / 2 + 0.005
        assert len(series.value) == len(true_s)


def test_two_samples_of_a_phone_within_one_millisecond_are_kept_apart(tmp_path: Path) -> None:
    true_s = np.sort(np.arange(4000) / 100.0 + RNG.normal(0.0, 0.003, 4000))
    stamps = np.round(true_s, 3)
    equal = np.count_nonzero(np.diff(stamps) < 0.0005)
    assert equal > 3
    series = series_of(tmp_path / "a.csv", stamps, RNG.standard_normal(4000))
    assert np.abs(series.time_ns * 1e-9 - stamps).max() <= 0.5e-3
    assert f"{equal} of 4000 time stamps equal the one before, rounded to 1 ms" in series.notices[0]


def test_whole_seconds_are_stamps_too(tmp_path: Path) -> None:
    true_s = 0.3 + np.arange(1200) / 100.0
    series = series_of(tmp_path / "a.csv", np.floor(true_s), RNG.standard_normal(1200), decimals=0)
    # Twelve seconds with some hundred rows each tell the clock to a row or so.
    assert error_s(series, true_s) < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_batches_that_were_delivered_twice_are_dropped(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s, value = np.arange(1000) / 100.0, rng.standard_normal(1000)
    rows: list[int] = []
    for begin in range(0, 1000, 50):
        batch = list(range(begin, begin + 50))
        again = batch if rng.random() < 0.5 else batch[int(rng.integers(50)) :]
        rows += batch + (again if rng.random() < 0.4 else [])
    assert len(rows) > 1000
    series = series_of(tmp_path / "a.csv", time_s[rows], value[rows])
    np.testing.assert_allclose(series.time_ns * 1e-9, time_s, atol=1e-9)
    np.testing.assert_allclose(series.value, value, atol=1e-6)
    assert f"{len(rows) - 1000} duplicate rows were dropped" in series.notices[0]


def test_rows_that_go_back_and_say_something_else_are_refused(tmp_path: Path) -> None:
    rows = [*range(100), *range(60, 100), *range(100, 200)]
    value = RNG.standard_normal(240)
    with pytest.raises(DataError, match="time must increase from row to row"):
        series_of(tmp_path / "a.csv", np.array(rows) / 100.0, value)


def test_a_clock_that_hangs_is_no_rounding(tmp_path: Path) -> None:
    stamps = np.arange(400) / 100.0
    stamps[100:110] = stamps[100]
    with pytest.raises(DataError, match="time must increase from row to row"):
        series_of(tmp_path / "a.csv", stamps, RNG.standard_normal(400))


def test_equal_values_by_chance_are_no_repetitions_and_all_axes_keep_the_same_rows(tmp_path: Path) -> None:
    true_s = np.arange(2000) / 199.7
    # An axis of a coarse converter, where every third neighbour is equal, and a fine one.
    coarse, fine = np.round(RNG.standard_normal(2000)), RNG.standard_normal(2000)
    both = [series_of(tmp_path / "a.csv", true_s, coarse, fine, decimals=2, value=name) for name in ("a0", "a1")]
    alone = series_of(tmp_path / "b.csv", true_s, coarse, decimals=2)
    for series in (*both, alone):
        assert len(series.value) == 2000
        np.testing.assert_array_equal(series.time_ns, both[0].time_ns)


@pytest.mark.parametrize("day", ["", "2024-05-04 ", "04.05.2024 "])
@pytest.mark.parametrize("width", [3, 0])
def test_thousandths_behind_a_colon_are_read(tmp_path: Path, day: str, width: int) -> None:
    stamps = [f"{day}10:21:{33 + k // 50:02d}:{20 * (k % 50):0{width}d}" for k in range(120)]
    (tmp_path / "a.csv").write_text("time,gFx\n" + "".join(f"{t},{0.01 * k % 0.07}\n" for k, t in enumerate(stamps)))
    series = read_series(tmp_path / "a.csv", SeriesRequest("acceleration", unit="g"))
    np.testing.assert_array_equal(np.diff(series.time_ns), 20_000_000)
    assert (series.time_ns[0] // 1_000_000_000) % 86400 == 10 * 3600 + 21 * 60 + 33
