"""`midspan serve STORE`."""

from pathlib import Path

import click

from midspan.cli.access import announce_admin
from midspan.cli.console import Console, common_options
from midspan.cli.process import stop_by_signals


@click.command("serve")
@click.argument("store")
@click.option(
    "--listen", default="127.0.0.1:8080", show_default=True, help="HOST:PORT; an address other than loopback needs TLS."
)
@click.option("--tls-cert", type=click.Path(exists=True, dir_okay=False), help="Certificate (PEM) with its chain.")
@click.option("--tls-key", type=click.Path(exists=True, dir_okay=False), help="Its key (PEM).")
@click.option(
    "--for", "for_s", type=click.FloatRange(0.0, min_open=True), help="Seconds to run. Default: until stopped."
)
@common_options
def command(
    store: str, listen: str, tls_cert: str | None, tls_key: str | None, for_s: float | None, quiet: bool, as_json: bool
) -> None:
    """Serve page and REST interface of a store: stored rows, and live ones of a running `midspan run`.

    The first start makes the user `admin` and prints its password once (not with --quiet).
    """
    import asyncio

    from midspan.errors import DataError
    from midspan.serve.process import ServeSettings, more_descriptors, served
    from midspan.service.supervise import listening
    from midspan.settings.site import require_service
    from midspan.store.store import is_store

    console = Console(quiet, as_json)
    require_service(listen, tls_cert, tls_key, "--listen")
    if not is_store(store):
        raise DataError(f"{store}: is not a store. `midspan run` and `midspan replay` create one.")
    paths = [None if one is None else Path(one) for one in (tls_cert, tls_key)]
    settings = ServeSettings(store, None, paths[0], paths[1])
    more_descriptors()

    async def main() -> str:
        ending = asyncio.Event()
        stop_by_signals(asyncio.get_running_loop(), ending.set)
        with listening(listen, "--listen") as listener:
            host, port = listen.rpartition(":")[0], listener.getsockname()[1]
            address = f"http{'' if tls_cert is None else 's'}://{host}:{port}"
            announce_admin(store, console)
            console.say(f"page: {address}")
            if for_s is not None:
                asyncio.get_running_loop().call_later(for_s, ending.set)
            await served(settings, listener, ending)
        return address

    console.document({"store": store, "address": asyncio.run(main())})
