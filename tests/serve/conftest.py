"""A store with ten minutes of rows, an engine that says what a test lets it, and the server's own process on both."""

import re
import time

import pytest
from page import EXPECTED, WIDE, LiveSite, address

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


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """A site whose rows come at real time."""
    made = LiveSite(tmp_path_factory.mktemp("page"))
    yield made
    made.stop()


@pytest.fixture(scope="module")
def cookie(browser, site):
    """A session that the tests share: each login is a hash of a quarter of a second."""
    context = browser.new_context()
    answer = context.request.post(address(site), data={"user": "anna", "password": site.password})
    assert answer.ok
    kept = context.cookies()
    context.close()
    return kept


@pytest.fixture
def opened(browser, site, cookie):
    """A function that opens a view; what goes wrong on it, or leaves the host, is seen at the end."""
    contexts, wrong, asked = [], [], []

    def open_view(view="site", port=None, logged_in=True, viewport=WIDE, **options):
        context = browser.new_context(viewport=viewport, **options)
        contexts.append(context)
        if logged_in:
            context.add_cookies(cookie)
        page = context.new_page()
        page.set_default_timeout(10_000)
        page.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"http://127.0.0.1:{port or site.served.port}/#/{view}")
        return page

    yield open_view
    for context in contexts:
        context.close()
    assert [text for text in wrong if not EXPECTED.search(text)] == []
    assert [url for url in asked if not re.match(r"(blob:)?(http|ws)://127\.0\.0\.1:", url)] == []
