"""`write_report`: one HTML file about a result."""

from datetime import UTC, datetime
from pathlib import Path

from midspan._version import __version__
from midspan.checks import instance, path_of
from midspan.recording.result import Result
from midspan.records import TimeSeries
from midspan.report import page, sections, tables
from midspan.report.drawing import style
from midspan.report.material import Material, gather
from midspan.signals.stamps import shown
from midspan.writing import write_whole


def write_report(
    result: Result, path: str | Path, reference: TimeSeries | None = None, across: TimeSeries | None = None
) -> Path:
    """Write the report of a result as one self-contained HTML file; returns its path.

    path: the file, whole or not at all; reference: displacement in m on the accelerometer's clock, compared and drawn;
    across: the same along the second image axis. Needs no network to be read. Raises UsageError where the file cannot
    be written.
    """
    path = path_of("path", path)
    instance("result", result, Result, "what `midspan.estimate` returns")
    for name, given in (("reference", reference), ("across", across)):
        if given is not None:
            instance(name, given, TimeSeries, "a TimeSeries", "Name its file in the recording's [reference].")
    write_whole(path, report_html(result, reference, across).encode())
    return path


def report_html(result: Result, reference: TimeSeries | None = None, across: TimeSeries | None = None) -> str:
    """The page's text; reference, across: as for `write_report`."""
    material = gather(result, reference, across)
    with style():
        top, rest = _answer(material), _evidence(material)
    head = [page.heading(material.name, _lines(material)), sections.verdict(material)]
    body = [*head, *top, *rest, sections.footer(material)]
    return page.document(f"{material.name} – midspan report", body)


def _answer(material: Material) -> list[str]:
    """What everybody reads: the time history, six figures, the worst warnings."""
    return [sections.displacement(material), page.cards(tables.summary(material)), sections.warnings(material)]


def _evidence(material: Material) -> list[str]:
    """The sections that open on a click, in their order."""
    found = [
        sections.events(material),
        sections.band(material),
        sections.closer(material),
        sections.second_axis(material),
        sections.spectra(material),
        sections.calibration(material),
        sections.innovations(material),
        sections.camera(material),
        sections.cameras(material),
        sections.radar(material),
        sections.numbers(material),
    ]
    return [piece for piece in found if piece]


def _lines(material: Material) -> list[str]:
    result = material.result
    rows = result.estimate.time_ns
    sensors = " and ".join(["accelerometer", *(m.name for m in material.measured)])
    return [
        f"Displacement from {sensors} · {tables.method_words(result.method)}",
        f"From {shown(int(rows[0]))} to {shown(int(rows[-1]))} on the accelerometer's clock",
        f"Written {datetime.now(UTC):%Y-%m-%d %H:%M} UTC by midspan {__version__}",
    ]
