"""Every table and figure of the papers, three seeds: `midspan papers`."""

from midspan.cli.main import run


def main() -> None:
    run(["papers"])
