"""`midspan estimate RECORDING`, or `midspan estimate ACCEL FILE2`."""

import math
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, common_options
from midspan.notices import notice_trees, worst_first
from midspan.papers.published import PAPER_KEYS

if TYPE_CHECKING:
    from midspan.evaluate.methods import MethodRun
    from midspan.recording.result import Result
    from midspan.recording.streams.recording import Recording
    from midspan.records import TimeSeries
    from midspan.settings.two_files import Choices


@click.command("estimate")
@click.argument("recording", type=click.Path())
@click.argument("file2", type=click.Path(), required=False)
@click.option("--value", help="Two files: channel along the motion.")
@click.option("--unit", help="Two files: unit of the channel, if the file has none.")
@click.option("--direction", type=click.Choice(["x", "y"]), help="Two files: image axis of the motion. Default: y.")
@click.option("--rate-hz", type=float, help="Two files: rate of FILE2, if it has no times.")
@click.option("--displacement-value", metavar="NAME", help="Two files: displacement channel of FILE2.")
@click.option("--displacement-unit", help="Two files: unit of that channel, if the file has none.")
@click.option(
    "-c",
    "--calibration",
    "calibration_file",
    type=click.Path(),
    help="Calibration to use. Default: calibrate this recording.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    help="Result; the suffix selects the format. Default: result.csv. With --method all: the picture.",
)
@click.option("--method", help="Method; overrides the recording's. `all`: compare all in a table and methods.png.")
@click.option("--reference", type=click.Path(), help="With --method all: file of the reference displacement.")
@click.option("--reference-unit", help="Unit of the reference, if its file has none.")
@click.option("--literal", is_flag=True, help="Method, calibration and tracker as printed in the papers.")
@click.option(
    "--paper",
    type=click.Choice(PAPER_KEYS),
    help="Tracker, calibration, method and keys of one paper; see `midspan methods --papers`.",
)
@click.option("--tracker", help="Tracker; overrides the recording's. See `midspan methods`.")
@click.option("--report", type=click.Path(), help="Write a self-contained HTML report.")
@click.option("-v", "--verbose", is_flag=True, help="Print all figures, all warnings and the errors outside the band.")
@click.option("--point", help="Store: point to recompute from its raw records.")
@click.option("--from", "begin", help="Store: first instant, ISO 8601 or seconds since 1970.")
@click.option("--to", "end", help="Store: last instant.")
@common_options
def command(recording: str, file2: str | None, quiet: bool, as_json: bool, **options: Any) -> None:
    """Estimate displacement in mm at the accelerometer's rate, with its standard deviation.

    RECORDING is a folder with recording.toml, a store, or an accelerometer file followed by FILE2: a video, or the
    table of a displacement sensor. A phone's log may hold its video.
    """
    from midspan.settings.two_files import Choices, in_words_of_two_files
    from midspan.sources.accelerometer.phone import is_phone_log

    console = Console(quiet, as_json)
    options["every"] = options["method"] == ALL
    if options["every"]:
        options["method"] = None
    elif options["reference"] or options["reference_unit"]:
        raise click.UsageError("--reference: needs --method all. For one result use `midspan compare`.")
    choices = Choices(**{one.name: options.pop(one.name) for one in fields(Choices)})
    if file2 is not None or is_phone_log(recording):
        second = None if file2 is None else Path(file2)
        with in_words_of_two_files(Path(recording), second):
            _of_two_files(Path(recording), second, choices, console, options)
        return
    if choices.named:
        option = f"--{choices.named[0].replace('_', '-')}"
        raise click.UsageError(f"{option}: needs two files, ACCEL FILE2. For a recording set it in recording.toml.")
    from midspan.store.store import is_store

    if is_store(recording):
        with TemporaryDirectory(prefix="midspan-") as folder:
            _of_store(recording, Path(folder), console, options)
        return
    given = [name for key, name in (("point", "--point"), ("begin", "--from"), ("end", "--to")) if options[key]]
    if given:
        raise click.UsageError(f"{given[0]}: needs a store; {recording} is not a store.")
    _of_recording(recording, console, options)


def _of_store(where: str, folder: Path, console: Console, options: dict[str, Any]) -> None:
    """Compute a segment of a store again, with the calibration that is in force where none is given."""
    from midspan.errors import MidspanError
    from midspan.service.replay import point_name
    from midspan.service.stored_recording import chosen_point, in_words_of_a_store, instant, stored_recording
    from midspan.store.store import open_store

    store = open_store(where, read_only=True)
    try:
        point = chosen_point(store, options["point"])
        begin, end = instant(options["begin"], "--from"), instant(options["end"], "--to")
        _, calibration = stored_recording(store, point, folder, begin, end)
    finally:
        store.close()
    if options["calibration_file"] is None:
        options["calibration_file"] = str(calibration.save(folder))
    output = options["output"] or f"{point_name(point)}.csv"
    try:
        _of_recording(str(folder), console, {**options, "output": output})
    except MidspanError as error:
        raise type(error)(in_words_of_a_store(str(error), folder, where, point)) from None
    except click.UsageError as error:
        raise click.UsageError(in_words_of_a_store(error.message, folder, where, point)) from None


def _of_recording(recording: str, console: Console, options: dict[str, Any]) -> None:
    """Estimate a recording, and write and show what was asked for."""
    opened = open_with(recording, options["tracker"], options["method"], options["literal"], paper=options["paper"])
    console.progress(0, 1, "reading the recording")
    _of_opened(opened, console, options)


def _of_two_files(
    accel: Path, second: Path | None, choices: "Choices", console: Console, options: dict[str, Any]
) -> None:
    """Estimate an accelerometer's file and that of another sensor, or a phone's log."""
    from midspan.recording.streams.recording import Recording
    from midspan.settings.two_files import ACCELERATION, DISPLACEMENT, draft, settings_of

    if options["point"] or options["begin"] or options["end"]:
        raise click.UsageError("--point, --from and --to: need a store; received two files.")
    found = draft(accel, second, choices)
    if options["tracker"] and found.second == DISPLACEMENT.section:
        raise click.UsageError(f"--tracker {options['tracker']}: {second} is a table, with nothing to track.")
    tree = found.sections
    tree["fusion"] = {"literal": bool(options["literal"])}
    if options["literal"]:
        # No printed method takes one.
        tree.pop("gyroscope", None)
    for section, key in ((found.second, "tracker"), ("fusion", "method")):
        if options[key]:
            tree[section][key] = options[key]
    for line in found.said:
        console.say(line)
    for section in (ACCELERATION.section, DISPLACEMENT.section) if not found.said else ():
        for channel in ("value", "unit"):
            if channel in tree.get(section, {}):
                console.say(f"{Path(tree[section]['file']).name}: {channel} {tree[section][channel]}")

    where, settings = settings_of(found)
    settings = settings.calibrated_as_printed() if options["literal"] else settings
    _of_opened(Recording(where, settings), console, options)


def _of_opened(opened: "Recording", console: Console, options: dict[str, Any]) -> None:
    """Estimate what is open, and write and show what was asked for."""
    if options["every"]:
        compare_methods(opened, console, options)
        return
    from midspan.cli.targets import check_result, report_path
    from midspan.recording.estimate import estimate
    from midspan.settings.stored.calibration import load_calibration
    from midspan.sinks.write import check_target

    output = check_result(options["output"] or _own_place(opened), opened)
    check_target(output)
    report = report_path(options["report"])
    compared = report is not None and opened.has("reference")
    references = (opened.reference, opened.reference_across) if compared else (None, None)
    calibration = load_calibration(options["calibration_file"]) if options["calibration_file"] else None
    result = estimate(opened, calibration, progress=console.progress)
    console.done()
    written = [str(output)]
    if report is not None:
        # The report comes first: should it fail, no result stands under its final name.
        write_report(result, report, references, console)
        written.append(str(report))
    result.save(output)
    show(console, result, written, options["verbose"])


def _own_place(opened: "Recording") -> Path:
    """result.csv in the recording's folder; after the second of two files where that is the result of others."""
    from midspan.trees import TreeError, read_json

    usual = opened.folder / "result.csv"
    if opened.file.suffix == ".toml" or not usual.exists():
        return usual
    named = [file for _, file in opened.streams]
    with suppress(OSError, TreeError, AttributeError, KeyError, TypeError):
        sections = [one for one in read_json(usual.with_suffix(".json"))["settings"].values() if isinstance(one, dict)]
        if {one["file"] for one in sections if "file" in one} == set(named):
            return usual
    return opened.folder / f"{Path(opened.sensors[0].settings.file).stem}.csv"


def open_with(
    recording: str,
    tracker: str | None,
    method: str | None = None,
    literal: bool = False,
    *,
    fused: bool = True,
    paper: str | None = None,
) -> "Recording":
    """Open a recording with the tracker and method of the command line, which win over its own.

    literal: calibration, tracker and, where it is `fused`, method are as printed. paper: all three as a paper has them.
    """
    from midspan.checks import option
    from midspan.fusion.methods import METHODS
    from midspan.recording.kinds import has_printed
    from midspan.recording.streams.recording import open_with_cameras
    from midspan.vision.tracker import TRACKERS

    overrides: dict[str, dict[str, Any]] = {}
    if paper is not None:
        given = {"--tracker": tracker, "--method": method}
        if chosen_too := [name for name, value in given.items() if value is not None]:
            raise click.UsageError(f"--paper sets tracker and method; remove {' and '.join(chosen_too)}.")
        return as_in_paper(paper, recording)
    chosen: dict[str, Any] = {} if tracker is None else {"tracker": option("--tracker", tracker, TRACKERS)}
    if method is not None:
        overrides["fusion"] = {"method": option("--method", method, METHODS)}
    if literal and fused:
        overrides["fusion"] = overrides.get("fusion", {}) | {"literal": True}
    opened = open_with_cameras(recording, chosen, **overrides)
    if literal and not fused and has_printed(opened):
        # A radar's targets and factors as printed belong to a method as printed.
        opened = open_with_cameras(recording, chosen, fusion={"literal": True, "method": "fir"})
    if literal:
        opened = type(opened)(opened.file, opened.settings.calibrated_as_printed())
    if tracker is not None and not opened.cameras:
        raise click.UsageError(f"--tracker {tracker}: {opened.file} has no [camera] or [infrared] to track.")
    return opened


def as_in_paper(key: str, recording: str) -> "Recording":
    """A recording with everything as one paper has it."""
    from midspan.papers.published import PAPERS
    from midspan.recording.streams.recording import open_recording
    from midspan.settings.kinds import CAMERAS

    paper, plain = next(one for one in PAPERS if one.key == key), open_recording(recording)
    if not any(plain.has(kind) for kind in paper.sensors):
        needed = " or ".join(f"[{kind}]" for kind in paper.sensors)
        raise click.UsageError(f"--paper {key}: {plain.file} has no {needed}, which this paper needs.")
    tracked = {"tracker": paper.tracker} if paper.tracker else {}
    sections = {name: paper.of_section(name) | tracked for name in CAMERAS if plain.has(name)}
    fusion = {"method": paper.method, "literal": True, **paper.of_section("fusion")}
    opened = open_recording(recording, fusion=fusion, **sections)
    return type(opened)(opened.file, opened.settings.calibrated_as_printed())


def write_report(
    result: "Result", path: Path, references: "tuple[TimeSeries | None, TimeSeries | None]", console: Console
) -> None:
    """The HTML report; references: along the main and the second axis."""
    from midspan.report.report import write_report as write

    console.progress(0, 1, "writing the report")
    write(result, path, *references)
    console.done()


def _extent(f: dict[str, Any], axis: str = "") -> list[tuple[str, str]]:
    """The displacement's range and its typical standard deviation; axis: the second one of the image."""
    along = f" along {axis}" if axis else ""
    return [
        (f"displacement{along}", f"{f['smallest_mm']:.4g} … {f['largest_mm']:.4g} mm, {f['rms_mm']:.4g} mm rms"),
        (f"standard deviation{along}", f"{f['median_std_mm']:.3g} mm (median)"),
    ]


def show(console: Console, result: "Result", written: list[str], verbose: bool = False) -> None:
    """Print what a result says, in eight lines at most, and where it went; verbose: all figures and warnings."""
    f = result.figures()
    console.say(f"  {result.verdict}")
    console.table(_all_rows(result, f, written) if verbose else _first_rows(result, f, written))
    if verbose:
        console.warn(worst_first(result.warnings))
    else:
        console.warn_first(result.warnings)
    console.document(
        {
            "verdict": result.verdict,
            "figures": f,
            "method": result.method,
            "written": written,
            "warnings": list(result.warnings),
            "notices": notice_trees(result.warnings),
            "not_in_band": list(result.not_in_band),
            "calibration": result.calibration.to_dict(),
        }
    )


def _first_rows(result: "Result", f: dict[str, Any], written: list[str]) -> list[tuple[str, str]]:
    """The rows that everybody needs."""
    more = "; --verbose lists the errors outside the band" if result.not_in_band else ""
    sigma = f"{f['median_std_mm']:.3g} mm (median), zero {f['zero_std_mm']:.3g} mm{more}"
    return [
        ("rows", f"{f['rows']} from {f['start_s']:.3f} to {f['end_s']:.3f} s ({result.method}), {_statuses(f)}"),
        ("standard deviation", sigma),
        ("written", ", ".join(written)),
    ]


def _all_rows(result: "Result", f: dict[str, Any], written: list[str]) -> list[tuple[str, str]]:
    """All figures of a result."""
    sources = [f"{100 * part:.3g} % {word}" for word, part in f["source"].items()]
    return [
        ("rows", f"{f['rows']} from {f['start_s']:.3f} to {f['end_s']:.3f} s ({result.method})"),
        *_extent(f),
        ("standard deviation of the zero", f"{f['zero_std_mm']:.3g} mm, common to all rows"),
        ("standard deviation without zero", f"{f['median_own_std_mm']:.3g} mm"),
        *([] if result.across is None else _extent(result.across.figures(), result.across.axis)),
        *([("delay", f"{f['delay_s']:.3g} s of later data for each row")] if f["delay_s"] else []),
        ("status", _statuses(f)),
        *([("source", ", ".join(sources))] if len(sources) > 1 else []),
        *(("not in the band" if k == 0 else "", f"{line}") for k, line in enumerate(result.not_in_band)),
        ("written", ", ".join(written)),
    ]


def _statuses(f: dict[str, Any]) -> str:
    return ", ".join(f"{100 * part:.3g} % {word}" for word, part in f["status"].items() if part > 0)


# What stands for all methods, as the value of --method.
ALL = "all"
HEADINGS = ("method", "RMSE", "inside ±1.96 σ", "without zero", "inside", "σ", "delay", "takes")


def compare_methods(opened: "Recording", console: Console, options: dict[str, Any]) -> None:
    """Run all methods on a recording, print the table, and write the picture."""
    from midspan.cli.targets import check_picture
    from midspan.evaluate.methods import reference_of, run_all
    from midspan.report.methods_figure import draw_methods
    from midspan.settings.stored.calibration import load_calibration

    if options["report"]:
        raise click.UsageError("--report: needs one method. Select it with --method, or remove --report.")
    target = check_picture(options["output"] or opened.folder / "methods.png", "-o", opened)
    given = None if options["reference"] is None else Path(options["reference"])
    reference = reference_of(opened, given, options["reference_unit"])
    calibration = load_calibration(options["calibration_file"]) if options["calibration_file"] else None
    runs = list(run_all(opened, calibration, reference=reference, progress=console.progress))
    console.done()
    draw_methods(runs, reference, target)
    console.columns(HEADINGS, [_row(run) for run in runs])
    for run in runs:
        if run.refused:
            console.say(f"  {run.name}: refused. {run.refused}")
    if reference is None:
        console.say("No reference: errors and coverage need --reference FILE or [reference] in recording.toml.")
    console.say(f"{target}: written.")
    console.document({"methods": [run.to_dict() for run in runs], "written": str(target)})


def _row(run: "MethodRun") -> tuple[str, ...]:
    """A method's row; empty cells where there is no figure."""
    if run.result is None:
        return (run.name, *[""] * (len(HEADINGS) - 1))
    found, against = run.result, run.comparison
    compared = [""] * 4
    if against is not None:
        pairs = [(one.rmse_mm, one.coverage_95) for one in (against.plain, against.without_zero)]
        cells = [(f"{rmse:.3g} mm", "" if share is None else f"{100 * share:.1f} %") for rmse, share in pairs]
        compared = [cell for pair in cells for cell in pair]
    delay = {0.0: "none", math.inf: "whole record"}.get(found.delay_s, f"{found.delay_s:.2g} s")
    return (run.name, *compared, f"{found.figures()['median_std_mm']:.3g} mm", delay, f"{run.took_s:.2g} s")
