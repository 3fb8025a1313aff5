"""`midspan open RECORDING`."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, common_options
from midspan.cli.process import stop_by_signals

if TYPE_CHECKING:
    import asyncio

REDIRECT = '<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0;url={}"><title>midspan</title>'


@click.command("open")
@click.argument("recording")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port on 127.0.0.1. Default: a free one.")
@click.option("--no-browser", is_flag=True, help="Only print the link.")
@click.option(
    "--for", "for_s", type=click.FloatRange(0.0, min_open=True), help="Seconds to run. Default: until stopped."
)
@common_options
def command(recording: str, port: int, no_browser: bool, for_s: float | None, quiet: bool, as_json: bool) -> None:
    """Open recordings in the browser: inspect, draw the region, calibrate, estimate, compare, export.

    Only this machine can connect, by the printed link, which works once. Enter prints another, Ctrl-C stops.
    """
    import asyncio
    from tempfile import TemporaryDirectory

    from midspan.serve.application import PAGE
    from midspan.serve.process import more_descriptors
    from midspan.serve.recordings.desk import Desk
    from midspan.serve.recordings.reading import recordings_at
    from midspan.serve.recordings.server import opened
    from midspan.service.supervise import listening

    console = Console(quiet, as_json)
    if not PAGE.is_dir():
        console.warn(["The page is not built. Run `make page`."])
    files = [file.absolute() for file in recordings_at(Path(recording))]
    more_descriptors()

    async def main(folder: Path) -> None:
        ending, loop = asyncio.Event(), asyncio.get_running_loop()
        stop_by_signals(loop, ending.set)
        with listening(f"127.0.0.1:{port}", "--port") as listener:
            desk, at = Desk(files, folder), f"http://127.0.0.1:{listener.getsockname()[1]}"

            def link() -> str:
                return f"{at}/#/link/{desk.access.link()}"

            def ready() -> None:
                address = link()
                console.document({"recordings": [str(file.parent) for file in files], "address": address})
                console.say(f"page: {address}\nThis link works once. Enter prints another, Ctrl-C stops.")
                sys.stdout.flush()
                if not no_browser:
                    _browse(link(), folder, console)
                _print_on_enter(link, console, loop)
                if for_s is not None:
                    loop.call_later(for_s, ending.set)

            await opened(desk, listener, ending, ready)

    # Only this user may look into it.
    with TemporaryDirectory(prefix="midspan-open-") as name:
        asyncio.run(main(Path(name)))


def _browse(address: str, folder: Path, console: Console) -> None:
    """Open the link in a browser by a file that leads there: what a program is started with all users may see."""
    import threading
    import webbrowser

    from midspan.writing import write_whole

    file = folder / "open.html"
    write_whole(file, REDIRECT.format(address).encode(), mode=0o600)

    def begin() -> None:
        if not webbrowser.open(file.as_uri()):
            console.say("No browser found. Open the link in one.")

    # A browser of a terminal lasts until it is left.
    threading.Thread(target=begin, daemon=True).start()


def _print_on_enter(link: Callable[[], str], console: Console, loop: "asyncio.AbstractEventLoop") -> None:
    """Print another link for each line that is entered in a terminal."""
    if console.quiet or console.as_json or not sys.stdin or not sys.stdin.isatty():
        return

    def entered() -> None:
        if sys.stdin.readline():
            console.say(f"page: {link()}")
        else:
            loop.remove_reader(sys.stdin)

    loop.add_reader(sys.stdin, entered)
