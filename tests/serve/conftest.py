"""A store with ten minutes of rows, an engine that says what a test lets it, and the server's own process on both."""

import time

import pytest

from midspan.records import NANOSECONDS
from served import SECONDS, Engine, Served, logged_in, made_store, until


@pytest.fixture(scope="session")
def begin_ns():
    """When the rows of the store begin: so that the newest are of now."""
    return (time.time_ns() // NANOSECONDS - SECONDS) * NANOSECONDS


@pytest.fixture(scope="session")
def store_folder(tmp_path_factory, begin_ns):
    """A folder with a store, in a path that is too long for the address of a socket."""
    folder = (
        tmp_path_factory.mktemp("a path that is longer than what the address of a socket can hold, by far") / "store"
    )
    made_store(folder, begin_ns)
    return folder


@pytest.fixture(scope="session")
def tokens(store_folder):
    """Tokens by scope."""
    return {scope: logged_in(store_folder, scope, scope) for scope in ("read", "operate", "admin")}


@pytest.fixture(scope="session")
def engine(store_folder):
    """An engine that listens."""
    engine = Engine(store_folder)
    engine.site_file = str(store_folder.parent / "SITE.toml")
    engine.start()
    yield engine
    engine.end()


@pytest.fixture(scope="session")
def served(store_folder, tokens, engine):
    """The server's process on the store and the engine."""
    served = Served(store_folder)
    with served.client(tokens["read"]) as client:
        until(lambda: len(client.get("/api/v1/points").json()) == 2)
    yield served
    served.stop()


@pytest.fixture
def reader(served, tokens):
    """A client that may look."""
    with served.client(tokens["read"]) as client:
        yield client


@pytest.fixture
def operator(served, tokens):
    """A client that may command."""
    with served.client(tokens["operate"]) as client:
        yield client


@pytest.fixture
def admin(served, tokens):
    """A client that may do everything."""
    with served.client(tokens["admin"]) as client:
        yield client
