"""`midspan export STORE`."""

from pathlib import Path

import click

from midspan.cli.console import Console, common_options


@click.command("export")
@click.argument("store")
@click.option("--point", help="Name of the point; may be left out where the store has only one.")
@click.option("--from", "begin", help="First instant: ISO 8601 (UTC where no zone is given) or seconds since 1970.")
@click.option("--to", "end", help="Last instant; left out: the newest row.")
@click.option(
    "-o", "--output", type=click.Path(), help="File (.csv .parquet .h5 .mat .mseed .uff); left out: POINT.csv."
)
@common_options
def command(
    store: str, point: str | None, begin: str | None, end: str | None, output: str | None, quiet: bool, as_json: bool
) -> None:
    """Write rows of a store in the columns and formats of a result."""
    console = Console(quiet, as_json)
    from midspan.cli.targets import check_result
    from midspan.service.replay import point_name
    from midspan.service.stored_rows import chosen_point, instant, stored_table
    from midspan.sinks.write import check_target, write_result
    from midspan.store.store import open_store

    kept = open_store(store, read_only=True)
    try:
        name = chosen_point(kept, point)
        target = check_result(Path(output or f"{point_name(name)}.csv"))
        check_target(target)
        table = stored_table(kept, name, instant(begin, "--from"), instant(end, "--to"))
    finally:
        kept.close()
    write_result(target, table)
    count = len(table.time_ns)
    console.table([("point", name), ("rows", str(count)), ("written", str(target))])
    console.document({"point": name, "rows": count, "written": str(target)})
