"""`midspan export STORE`, or `midspan export RESULT`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, common_options

if TYPE_CHECKING:
    from midspan.sinks.table import ResultTable


@click.command("export")
@click.argument("store")
@click.option("--point", help="Point; needed if the store has several.")
@click.option("--from", "begin", help="First instant, ISO 8601 (UTC) or seconds since 1970.")
@click.option("--to", "end", help="Last instant. Default: the newest row.")
@click.option(
    "-o",
    "--output",
    type=click.Path(),
    help="File to write; the suffix selects the format. Default: POINT.csv.",
)
@common_options
def command(store: str, quiet: bool, as_json: bool, **options: str | None) -> None:
    """Export rows of a store as a result file, or convert a result or track to another format.

    STORE is a store, or a file that `midspan estimate` or `midspan track` wrote.
    """
    console = Console(quiet, as_json)
    from midspan.evaluate.stored_table import READERS
    from midspan.sinks.write import write_result

    of_file = Path(store).is_file() or (Path(store).suffix.lower() in READERS and not Path(store).exists())
    name, target, table = (_of_file if of_file else _of_store)(store, options)
    write_result(target, table)
    count = len(table.time_ns)
    console.table([("file" if of_file else "point", name), ("rows", str(count)), ("written", str(target))])
    console.document({"file" if of_file else "point": name, "rows": count, "written": str(target)})


def _of_file(path: str, options: dict[str, str | None]) -> "tuple[str, Path, ResultTable]":
    """The table of a result's file, and where it goes."""
    from midspan.evaluate.stored_table import read_table

    given = [name for key, name in (("point", "--point"), ("begin", "--from"), ("end", "--to")) if options[key]]
    if given:
        raise click.UsageError(f"{given[0]}: needs a store; {path} is a file.")
    if options["output"] is None:
        raise click.UsageError("-o: is missing. Name the file to write; its suffix selects the format.")
    return path, _target(options["output"]), read_table(Path(path))


def _of_store(store: str, options: dict[str, str | None]) -> "tuple[str, Path, ResultTable]":
    """The rows of a point of a store, and where they go."""
    from midspan.service.replay import point_name
    from midspan.service.stored_recording import chosen_point, instant, stored_table
    from midspan.store.store import open_store

    kept = open_store(store, read_only=True)
    try:
        name = chosen_point(kept, options["point"])
        target = _target(options["output"] or f"{point_name(name)}.csv")
        table = stored_table(kept, name, instant(options["begin"], "--from"), instant(options["end"], "--to"))
    finally:
        kept.close()
    return name, target, table


def _target(output: str) -> Path:
    """The file to write, refused before the work where it could not be written."""
    from midspan.cli.targets import check_result
    from midspan.sinks.write import check_target

    target = check_result(Path(output))
    check_target(target)
    return target
