"""Text columns in every dialect: the same series must come out whatever way it was written."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from midspan.errors import DataError, UsageError
from midspan.records import TimeSeries
from midspan.sources.accelerometer import dialect as dialect_module
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series

STEP_NS = 10_000_000
START_NS = 1_714_564_800_250_000_000  # 2024-05-01 12:00:00.25 UTC


def read_text(folder: Path, text: str, encoding: str = "utf-8", **request: object) -> TimeSeries:
    path = folder / "logger.csv"
    path.write_bytes(text.encode(encoding))
    return read_series(path, SeriesRequest("acceleration", **{"unit": "m/s^2", **request}))  # type: ignore[arg-type]


def decimal(value: float, sign: str) -> str:
    return f"{value:.6f}".replace(".", sign)


def stamp(time_ns: int, form: str, sign: str) -> str:
    moment = np.datetime64(time_ns, "ns")
    date, clock = str(moment)[:10], str(moment)[11:]
    seconds = f"{time_ns // 10**9}{sign}{time_ns % 10**9:09d}"
    relative = f"{(time_ns - START_NS) // 10**9}{sign}{(time_ns - START_NS) % 10**9:09d}"
    forms = {
        "seconds": relative,
        "epoch_s": seconds,
        "epoch_ms": str(time_ns // 10**6),
        "epoch_us": str(time_ns // 10**3),
        "epoch_ns": str(time_ns),
        "iso": f"{date}T{clock}",
        "iso_blank": f"{date} {clock}",
        "iso_zone": f"{date}T{clock}+00:00",
        "iso_z": f"{date}T{clock}Z",
    }
    return forms[form]


VALUES = np.array([0.012670, -0.5, 9.81, 0.0, -1.25, 3.0, 0.000001, -12.75])

DIALECTS = st.fixed_dictionaries(
    {
        "delimiter": st.sampled_from([",", ";", "\t", "|", " "]),
        "sign": st.sampled_from([".", ","]),
        "header": st.booleans(),
        "unit_row": st.booleans(),
        "preamble": st.sampled_from(["", "Logger X\nSerial: 12\n\n", "# made by hand\n# rate 100\n"]),
        "form": st.sampled_from(
            ["seconds", "epoch_s", "epoch_ms", "epoch_us", "epoch_ns", "iso", "iso_blank", "iso_zone", "iso_z"]
        ),
        "end": st.sampled_from(["\n", "\r\n"]),
        "trailing": st.booleans(),
        "encoding": st.sampled_from(["utf-8", "utf-8-sig", "latin-1", "utf-16"]),
    }
)


@settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dialect=DIALECTS)
def test_any_dialect_gives_the_same_series(tmp_path: Path, dialect: dict[str, object]) -> None:
    delimiter, sign, form = str(dialect["delimiter"]), str(dialect["sign"]), str(dialect["form"])
    if delimiter == sign or (delimiter == " " and dialect["trailing"]):
        return  # "1,5,2,5" cannot be distinguished by anyone; blanks at the end of a line are no delimiter
    end = delimiter if dialect["trailing"] else ""
    rows = [delimiter.join(["time", "acc"]) + end] if dialect["header"] else []
    rows += [delimiter.join(["s" if form == "seconds" else "-", "m/s^2"]) + end] if dialect["unit_row"] and rows else []
    times = START_NS + np.arange(VALUES.size) * STEP_NS
    for time_ns, value in zip(times, VALUES, strict=True):
        rows.append(delimiter.join([stamp(int(time_ns), form, sign), decimal(value, sign)]) + end)
    text = (str(dialect["preamble"]) + "\n".join(rows) + "\n").replace("\n", str(dialect["end"]))

    series = read_text(tmp_path, text, str(dialect["encoding"]))

    expected = times - START_NS if form == "seconds" else times
    # Every form holds its digits in whole numbers or text, so not one nanosecond may be lost.
    np.testing.assert_array_equal(series.time_ns, expected)
    # Six decimals of numbers below 100: the nearest float is within 1 part in 2^52.
    np.testing.assert_allclose(series.value, VALUES, rtol=1e-15, atol=1e-21)


@pytest.mark.parametrize(
    ("text", "times_s", "values"),
    [
        ("0,00;0,5\n0,01;1,5\n", [0, 0.01], [0.5, 1.5]),
        ("t a\n0 1\n1 2\n", [0, 1], [1, 2]),
        ("  0.00   1.0\n  0.01  -2.0\n", [0, 0.01], [1, -2]),
        ("# time, accel\n0.0,1.0\n0.5,2.0\n", [0, 0.5], [1, 2]),
        ("time [s],accel [m/s^2]\n0,1\n1,2\n", [0, 1], [1, 2]),
        ("time [s]  accel [m/s^2]\n0 1\n1 2\n", [0, 1], [1, 2]),
        ('"time","accel"\n"0,5","1,25"\n"1,5","2,25"\n', [0.5, 1.5], [1.25, 2.25]),
        ("time_ms,a\n0,1\n10,2\n20,3\n", [0, 0.01, 0.02], [1, 2, 3]),
        ("time [ms];a\n0;1\n2,5;2\n", [0, 0.0025], [1, 2]),
        ("Zeit;Beschleunigung\nms;m/s²\n0;1,0\n5;2,0\n", [0, 0.005], [1, 2]),
        ("Bridge 4\nRate,100\nStart,2024-05-01\n\ntime,acc\n0.00,1.5\n0.01,2.5\n", [0, 0.01], [1.5, 2.5]),
        ("Date:,2024\nrows,3\n1,2\ntime,acc\n0.00,1.5\n0.01,2.5\n0.02,3\n", [0, 0.01, 0.02], [1.5, 2.5, 3]),
        ("t,a,remark\n0,1,ok\n1,2,bad\n", [0, 1], [1, 2]),
        ("t;a\n1E-2;1,5E+1\n2E-2;-1,5E-1\n", [0.01, 0.02], [15, -0.15]),
        ("00:00:01.5;1\n00:01:00.25;2\n", [1.5, 60.25], [1, 2]),
        ("date,time,acc\n2024-05-01,12:00:00.25,1\n2024-05-01,12:00:00.26,2\n", [START_NS * 1e-9 % 60, 0.26], [1, 2]),
        ("01.05.2024 12:00:00,250;1,5\n01.05.2024 12:00:00,260;2,5\n", [0.25, 0.26], [1.5, 2.5]),
        ("2024/05/01 12:00:00.250,1.5\n2024/05/01 12:00:00.260,2.5\n", [0.25, 0.26], [1.5, 2.5]),
        ("2024-05-01T14:00:00.25+02:00,1\n2024-05-01T14:00:00.26+02:00,2\n", [0.25, 0.26], [1, 2]),
        ("2024-05-01 12:00:00.25 1.5\n2024-05-01 12:00:00.26 2.5\n", [0.25, 0.26], [1.5, 2.5]),
        ("timestamp acc\n2024-05-01 12:00:00.25 1.5\n2024-05-01 12:00:00.26 2.5\n", [0.25, 0.26], [1.5, 2.5]),
    ],
)
def test_files_of_loggers_are_understood(tmp_path: Path, text: str, times_s: list[float], values: list[float]) -> None:
    series = read_text(tmp_path, text)
    day_ns = 86_400 * 10**9
    relative = series.time_ns % 60_000_000_000 if series.time_ns[0] > day_ns else series.time_ns
    # Times were written to a millisecond or better; they must come out to the nanosecond.
    np.testing.assert_allclose(relative, np.array(times_s) * 1e9, atol=300)
    np.testing.assert_allclose(series.value, values, rtol=1e-15)


def test_delimiters_that_are_in_no_line_are_tried_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[tuple[str, str]] = []
    real = dialect_module._try
    monkeypatch.setattr(dialect_module, "_try", lambda lines, *sign: tried.append(sign) or real(lines, *sign))
    (tmp_path / "a.csv").write_text("time_s,a\n" + "".join(f"{0.01 * k:.2f},{k % 7}\n" for k in range(50)))
    assert dialect_module.find_dialect(tmp_path / "a.csv").delimiter == ","
    # Comma, blanks and one of semicolon, tab and bar, each with both decimal signs.
    assert len(tried) == 6


def test_what_was_found_is_reported_in_plain_words(tmp_path: Path) -> None:
    series = read_text(tmp_path, "Logger 7\n\ntime;acc\ns;g\n0,0;1\n0,1;2\n", unit=None)
    text = ". ".join(series.notes)
    for words in ("delimiter ';'", "decimal comma", "header in line 3", "units in line 4", "unit g from the file"):
        assert words in text
    # 1 g is 9.80665 m/s² by definition (CGPM 1901).
    np.testing.assert_allclose(series.value, [9.80665, 19.6133], rtol=1e-15)


@pytest.mark.parametrize(
    ("heading", "units", "row"),
    [
        ("Heure;Voie 1 (X);Voie 3 (Z)", "hh:mm:ss;g;g", "14:31:02,{:03d};0,01;1,01"),
        ("Date;Heure;Voie 3 (Z)", "jj/mm/aaaa;hh:mm:ss;g", "12/06/2026;14:31:02,{:03d};1,01"),
        ("Horodatage;Voie 3 (Z)", "yyyy-mm-dd HH:MM:SS.fff;g", "2026-06-12 14:31:02.{:03d};1,01"),
    ],
)
def test_a_row_of_units_may_say_how_its_times_are_written(tmp_path: Path, heading: str, units: str, row: str) -> None:
    rows = [row.format(5 * k) for k in range(20)]
    series = read_text(
        tmp_path, "\n".join(["Site;Passerelle", "", heading, units, *rows]), unit=None, value="Voie 3 (Z)"
    )
    assert np.diff(series.time_ns).tolist() == [5_000_000] * 19
    np.testing.assert_allclose(series.value, 1.01 * 9.80665, rtol=1e-12)


PREAMBLE = "Date;12/06/2026\nFréquence d'échantillonnage;200 Hz\nNombre de voies;3\n\n"


@pytest.mark.parametrize("preamble", ["", PREAMBLE, "Rate;200\nChannels;3\nGain;1\n\n"])
@pytest.mark.parametrize("units", ["s;g;g\n", "hh:mm:ss;g;g\n"])
def test_a_heading_alone_has_no_data_rows(tmp_path: Path, preamble: str, units: str) -> None:
    with pytest.raises(DataError, match="no data rows: nothing follows its heading 'Temps;Voie 1;Voie 3'"):
        read_text(tmp_path, f"{preamble}Temps;Voie 1;Voie 3\n{units}")


@pytest.mark.parametrize("preamble", ["", PREAMBLE])
def test_names_alone_have_no_data_rows(tmp_path: Path, preamble: str) -> None:
    with pytest.raises(DataError, match="no data rows"):
        read_text(tmp_path, f"{preamble}Temps (s);Voie 1 (X);Voie 3 (Z)\n")


def test_a_last_line_of_words_is_no_heading(tmp_path: Path) -> None:
    rows = "".join(f"{k / 100:.2f};{k}\n" for k in range(5))
    (tmp_path / "logger.csv").write_text(f"t;a\n{rows}end;of;record\n")
    assert list_channels(tmp_path / "logger.csv").names == ("t", "a")


def test_halves_of_numbers_are_refused_whichever_is_named(tmp_path: Path) -> None:
    rows = "".join(f"0,{5 * k:03d},1,{k:06d}\n" for k in range(20))
    for value in (None, "column_4"):
        with pytest.raises(UsageError, match="comma seems to separate both columns and decimals"):
            read_text(tmp_path, f"Temps (s),Voie 3 (Z)\ns,g\n{rows}", value=value)
    # Decimal points show that the columns are whole, whatever the heading lacks.
    rows = "".join(f"{k / 200:.3f},1.0,0,1\n" for k in range(20))
    assert read_text(tmp_path, f"Temps,Voie\n{rows}", time="column_1", value="column_2").value[-1] == 1.0


def test_cells_that_are_no_numbers_become_nan_wherever_they_stand(tmp_path: Path) -> None:
    rows = [f"{k * 0.01:.2f},{k}" for k in range(1000)]
    rows[0], rows[700], rows[701], rows[702] = "0.00,ERR", "7.00,overload", "7.01,", "7.02,NaN"
    series = read_text(tmp_path, "t,a\n" + "\n".join(rows) + "\n")
    assert np.flatnonzero(np.isnan(series.value)).tolist() == [0, 700, 701, 702]
    assert series.value[703] == 703.0
    assert any("2 cells of a are no numbers" in note for note in series.notes)


def test_infinite_numbers_count_as_missing(tmp_path: Path) -> None:
    series = read_text(tmp_path, "t,a\n0,1\n1,inf\n2,-inf\n3,2\n")
    assert np.isnan(series.value).tolist() == [False, True, True, False]


def test_a_decimal_comma_in_a_single_column_is_not_a_delimiter(tmp_path: Path) -> None:
    series = read_text(tmp_path, "accel\n0,01\n0,25\n-1,50\n", rate_hz=100.0)
    np.testing.assert_allclose(series.value, [0.01, 0.25, -1.5], rtol=1e-15)


def test_a_file_of_numbers_alone_names_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "plain.txt"
    np.savetxt(path, np.column_stack([np.arange(5) * 0.1, np.arange(5.0), -np.arange(5.0)]))
    assert list_channels(path).names == ("column_1", "column_2", "column_3")
    series = read_series(path, SeriesRequest("acceleration", "column_1", "column_3", "m/s^2"))
    np.testing.assert_array_equal(series.value, -np.arange(5.0))


def test_a_rate_replaces_a_time_column(tmp_path: Path) -> None:
    series = read_text(tmp_path, "a\n1\n2\n3\n", rate_hz=3.0, start_s=1.5)
    # A third of a second rounded to whole nanoseconds, each stamp on its own.
    np.testing.assert_array_equal(series.time_ns, [1_500_000_000, 1_833_333_333, 2_166_666_667])


def test_rows_written_twice_are_dropped(tmp_path: Path) -> None:
    series = read_text(tmp_path, "t,a\n0,1\n1,2\n1,2\n2,3\n")
    np.testing.assert_array_equal(series.value, [1, 2, 3])
    assert any("1 duplicate rows" in note for note in series.notes)


def test_headings_that_differ_in_their_brackets_stay_apart(tmp_path: Path) -> None:
    text = "t,Acc (left),Acc (right),a [g],a [m/s^2]\n0,1,2,3,4\n1,2,3,4,5\n"
    for value, first in (("Acc (left)", 1), ("Acc (right)", 2), ("a [g]", 3), ("a [m/s^2]", 4)):
        assert read_text(tmp_path, text, value=value).value[0] == first
    with pytest.raises(UsageError, match="value = 'a' is not in the file"):
        read_text(tmp_path, text, value="a")
    for value in ("acc", "acc [g]", "ACC"):
        assert read_text(tmp_path, "t,acc [g]\n0,1\n1,2\n", value=value).value[1] == 2
    with pytest.raises(UsageError, match="not in the file"):
        read_text(tmp_path, "t,acc [g]\n0,1\n1,2\n", value="acc [mg]")


def test_a_latin_degree_sign_does_not_disturb(tmp_path: Path) -> None:
    series = read_text(tmp_path, "t;a;Temperatur [°C]\n0;1;20\n1;2;21\n", "latin-1", value="a")
    np.testing.assert_array_equal(series.value, [1, 2])


BAD = [
    ("hello\nworld\n", {}, DataError, ["no columns of numbers", "comma"]),
    ("t,a\n0,1\n1,2\n0.5,3\n", {}, DataError, ["row 3", "0.5 s after 1 s", "Sort"]),
    ("t,a\n0,1\n1,2\n1,3\n", {}, DataError, ["row 3", "1 s after 1 s"]),
    ("time,a\n0,1\n,2\n2,3\n", {}, DataError, ["1 of 3 time stamps", "row 2", "rate_hz"]),
    ("t,a\n0,1\n", {}, DataError, ["two numbers or more", "1 in 1 rows"]),
    ("t,a\n0,nan\n1,nan\n2,nan\n", {"value": "a"}, DataError, ["two numbers or more", "0 in 3 rows"]),
    ("t,accel\n0,1\n1,2\n", {"value": "acel"}, UsageError, ["value = 'acel'", "'accel'", "'t'"]),
    ("t,a\n0,1\n1,2\n", {"time": "tme"}, UsageError, ["time = 'tme'", "It holds 't', 'a'"]),
    ("t,p,q\n0,1,2\n1,2,3\n", {}, UsageError, ["value must name", "'p'", "'q'"]),
    ("a\n3\n2\n", {}, UsageError, ["has no time", "rate_hz"]),
    ("t,a\n0,1\n1,2\n", {"unit": None}, UsageError, ["unit of 'a' is not in the file", "m/s^2"]),
    ("t,a\n0,1\n1,2\n", {"unit": "m/ss2"}, UsageError, ["'m/ss2'", "Did you mean 'm/s2'"]),
    ("t,a\n0,1\n1,2\n", {"unit": "mm"}, UsageError, ["measure acceleration", "'mm'"]),
    ("t,a\n0,1\n1,2\n", {"unit": "V"}, UsageError, ["sensitivity in V per m/s^2"]),
    ("t,a\n0,1\n1,2\n", {"unit": "g", "sensitivity": 0.1}, UsageError, ["sensitivity", "Remove"]),
    ("t,a\n0,1\n1,2\n", {"rate_hz": -1.0}, UsageError, ["rate_hz must be above zero", "-1.0"]),
    ("t [mm],a\n0,1\n1,2\n", {"time": "t"}, UsageError, ["unit of time", "'mm'"]),
]


@pytest.mark.parametrize(("text", "request_keys", "kind", "words"), BAD)
def test_a_bad_file_or_setting_is_refused_with_its_remedy(
    tmp_path: Path, text: str, request_keys: dict[str, object], kind: type[Exception], words: list[str]
) -> None:
    with pytest.raises(kind) as caught:
        read_text(tmp_path, text, **request_keys)
    for word in [*words, "logger.csv"] if "rate_hz" not in request_keys else words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "kind", "words"),
    [
        ("missing.csv", None, DataError, ["does not exist", "path"]),
        ("empty.csv", b"", DataError, ["empty (0 bytes)"]),
        ("table.xyz", b"1", UsageError, ["'.xyz'", ".csv", ".mseed"]),
        *[
            (f"broken{s}", b"\x00\x01nonsense" * 9, DataError, ["cannot be read", "whole"])
            for s in (".parquet", ".npy", ".npz", ".mat", ".h5", ".tdms", ".mseed")
        ],
        ("broken.lvm", b"nonsense", DataError, ["cannot be read", "whole"]),
        ("broken.uff", b"nonsense", DataError, ["broken.uff"]),
        ("broken.v2", b"nonsense\n", DataError, ["no block of volume-2 values", "CSMIP"]),
    ],
)
def test_a_file_that_cannot_be_read_is_named(
    tmp_path: Path, name: str, content: bytes | None, kind: type[Exception], words: list[str]
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(kind) as caught:
        list_channels(path)
    for word in [*words, name]:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected", "words"),
    [
        ("25/04/2024", "2024-04-25", "day first"),
        ("04/25/2024", "2024-04-25", "month first"),
        ("05/04/2024", "2024-04-05", "could be the month"),
    ],
)
def test_dates_with_slashes_are_read_and_the_order_is_reported(
    tmp_path: Path, text: str, expected: str, words: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time,acc (g)\n" + "".join(f"{text} 09:30:0{i}.500,{i}\n" for i in range(5)), encoding="utf-8")
    series = read_series(path, SeriesRequest("acceleration"))
    first = np.datetime64(f"{expected}T09:30:00.500", "ns").astype(np.int64)
    np.testing.assert_array_equal(series.time_ns, first + np.arange(5) * 1_000_000_000)
    assert any(words in note for note in series.notes)


@pytest.mark.parametrize("line", ["Unité;g", "Unit: g", "Einheit;[g]", '"Unidad";"g"'])
def test_a_unit_in_the_preamble_is_that_of_all_channels_but_the_time(tmp_path: Path, line: str) -> None:
    path = tmp_path / "logger.csv"
    rows = "\n".join(f"{0.01 * k:.2f};0,1;1,0".replace(".", ",") for k in range(20))
    path.write_text(f"Logger 0417\nFréquence;100 Hz\n{line}\n\nTemps;Voie 1;Voie 2\n{rows}\n", encoding="utf-8")
    assert [one.unit for one in list_channels(path).channels] == [None, "g", "g"]


@pytest.mark.parametrize(("reading", "said"), [(1.002, "'g': at rest the values are 1.002"), (0.01, "such as")])
def test_the_question_for_a_unit_proposes_the_one_in_which_the_values_at_rest_are_gravity(tmp_path, reading, said):
    rows = "".join(f"{0.01 * k:.2f},{reading}\n" for k in range(20))
    with pytest.raises(UsageError, match=said):
        read_text(tmp_path, f"time,value\n{rows}", unit=None)
