"""`midspan estimate RECORDING`."""

from pathlib import Path
from typing import Any

import click

from midspan.cli.console import Console, common_options


@click.command("estimate")
@click.argument("recording", type=click.Path())
@click.option(
    "-c", "--calibration", "calibration_file", type=click.Path(), help="Calibration to use; left out: calibrate."
)
@click.option("-o", "--output", type=click.Path(), help="Result file (.csv .parquet .h5 .mat .mseed .uff); "
              "left out: result.csv in the recording.")  # fmt: skip
@click.option("--method", help="Fusion method, over the recording's own; see `midspan methods`.")
@click.option("--tracker", help="Tracker, over the recording's own.")
@click.option("--report", type=click.Path(), help="Write a self-contained HTML report.")
@common_options
def command(recording: str, quiet: bool, as_json: bool, **options: Any) -> None:
    """Estimate displacement in mm at the accelerometer's rate, with its standard deviation."""
    from midspan.recording.calibration import load_calibration
    from midspan.recording.estimate import estimate
    from midspan.recording.recording import open_recording
    from midspan.sinks.write import check_target

    console = Console(quiet, as_json)
    overrides: dict[str, dict[str, Any]] = {}
    if options["tracker"]:
        overrides["camera"] = {"tracker": options["tracker"]}
    if options["method"]:
        overrides["fusion"] = {"method": options["method"]}
    opened = open_recording(recording, **overrides)
    output = Path(options["output"] or opened.folder / "result.csv")
    check_target(output)
    check_report(options["report"])
    calibration = load_calibration(options["calibration_file"]) if options["calibration_file"] else None
    result = estimate(opened, calibration, progress=console.progress)
    console.done()
    result.save(output)
    written = [str(output)]
    if options["report"]:
        write_report_of(result, Path(options["report"]), console)
        written.append(options["report"])
    show(console, result, written)


def check_report(path: str | None) -> None:
    """Refuse a report that could not be written, before the work."""
    if path is None:
        return
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise click.UsageError(f"--report {path}: must end in .html.")
    if not Path(path).absolute().parent.is_dir():
        raise click.UsageError(f"--report {path}: the folder {Path(path).parent} does not exist; make it first.")


def write_report_of(result: Any, path: Path, console: Console) -> None:
    """The HTML report, with the recording's reference where it has one."""
    from midspan.report.report import write_report

    console.progress(0, 1, "writing the report")
    recording = result.recording
    reference = recording.reference if recording is not None and recording.has("reference") else None
    write_report(result, path, reference)
    console.done()


def show(console: Console, result: Any, written: list[str]) -> None:
    """Print the first figures of a result and where it went."""
    f = result.figures()
    share = ", ".join(f"{100 * part:.3g} % {word}" for word, part in f["status"].items() if part > 0)
    console.table(
        [
            ("rows", f"{f['rows']} from {f['start_s']:.3f} to {f['end_s']:.3f} s ({result.method})"),
            ("displacement", f"{f['smallest_mm']:.4g} … {f['largest_mm']:.4g} mm, {f['rms_mm']:.4g} mm rms"),
            ("standard deviation", f"{f['median_std_mm']:.3g} mm (median)"),
            ("status", share),
            ("written", ", ".join(written)),
        ]
    )
    console.warn(result.warnings)
    console.document(
        {
            "figures": f,
            "method": result.method,
            "written": written,
            "warnings": list(result.warnings),
            "calibration": result.calibration.to_dict(),
        }
    )
