"""`midspan methods`."""

import click

from midspan.cli.console import Console, common_options


@click.command("methods")
@click.option("--papers", is_flag=True, help="List the papers: tracker, method, options and command of each.")
@common_options
def command(papers: bool, quiet: bool, as_json: bool) -> None:
    """List trackers and fusion methods with their use, or the papers behind them."""
    from midspan.fusion.methods import DEFAULT_METHOD, METHODS
    from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS

    console = Console(quiet, as_json)
    if papers:
        _show_papers(console)
        return
    trackers = {name: entry.use for name, entry in TRACKERS.items()}
    methods = {name: row.use for name, row in METHODS.items()}
    for title, table, default in (("trackers", trackers, DEFAULT_TRACKER), ("fusion methods", methods, DEFAULT_METHOD)):
        console.say(f"{title} (default: {default}):")
        console.table(table.items())
        console.say()
    console.say("`midspan methods --papers` lists the papers; `midspan estimate --method all` compares the methods.")
    console.document(
        {
            "trackers": trackers,
            "default_tracker": DEFAULT_TRACKER,
            "methods": methods,
            "default_method": DEFAULT_METHOD,
        }
    )


def _show_papers(console: Console) -> None:
    """Each paper with what it is here."""
    from midspan.papers.published import PAPERS

    for paper in PAPERS:
        console.say(f"{paper.key} {paper.name}: {paper.citation}{f'; {paper.where}' if paper.where else ''}")
        console.table(
            [
                ("sensors", ", ".join(("accelerometer", *paper.sensors))),
                *([("tracker", paper.tracker)] if paper.tracker else []),
                ("method", paper.method),
                *((key, value) for key, value in paper.settings.items()),
                ("command", paper.command),
            ]
        )
        console.say()
    console.say("`midspan estimate RECORDING --paper KEY` takes the key, such as 003, that a paper begins with.")
    console.say(
        "Without --literal midspan also handles outliers, gaps and bias, and states a band that contains the errors."
    )
    console.document(
        {
            "papers": [
                {
                    "key": paper.key,
                    "name": paper.name,
                    "citation": paper.citation,
                    "where": paper.where or None,
                    "sensors": list(paper.sensors),
                    "tracker": paper.tracker or None,
                    "method": paper.method,
                    "settings": paper.settings,
                    "command": paper.command,
                }
                for paper in PAPERS
            ]
        }
    )
