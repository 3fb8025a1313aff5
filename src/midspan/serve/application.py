"""The application: the interface below /api/v1, health without a login, and the page's own files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.utils import get_openapi
from fastapi.responses import FileResponse, JSONResponse, PlainTextResponse
from pydantic import BaseModel, Field
from starlette.staticfiles import StaticFiles

from midspan._version import __version__
from midspan.serve import alarms, frequencies, live, login, points, problems, settings_file, sources
from midspan.serve.limits import Limits
from midspan.serve.login import READ, passwords
from midspan.serve.metrics import figures
from midspan.serve.serving import Serving, Shared
from midspan.service.live_socket import Tree

API = "/api/v1"
# Where the page's files are shipped, once they are built.
PAGE = Path(__file__).parent / "page"
PARTS = (login, points, frequencies, sources, alarms, settings_file, live)
"""A module a part of the interface, with its `routes`; another part is another name."""


class Standing(BaseModel):
    """As /readyz shows it; settings: what is wrong with SITE.toml, null where nothing is."""

    ready: bool
    points: list[dict[str, Any]]
    sources: list[dict[str, Any]]
    groups: list[dict[str, Any]] = Field([], description="of each group how many points give no rows, by reason")
    has_settings: bool = Field(description="whether the store has a SITE.toml here")
    settings: dict[str, Any] | None = Field(None, description="text, file and key of an error in SITE.toml")


def application(serving: Serving) -> Any:
    """The ASGI application over a store."""
    app = page_over(serving, [*(part.routes for part in PARTS), passwords])
    app.include_router(routes)
    return Limits(app)


def page_over(serving: Any, interface: Sequence[APIRouter]) -> FastAPI:
    """The page over something that has `access`, and the parts of its interface."""
    app = FastAPI(title="midspan", version=__version__, docs_url=None, redoc_url=None, openapi_url=None)
    app.state.serving = serving
    problems.install(app)
    for part in interface:
        app.include_router(part, prefix=API)
    app.include_router(description)
    app.openapi = lambda: _interface(app)  # type: ignore[method-assign]
    if PAGE.is_dir():
        # No mount at the root: it would take what other routes answer with 405.
        app.mount("/assets", StaticFiles(directory=PAGE / "assets"))
        app.include_router(page)
    else:
        app.include_router(no_page)
    return app


no_page = APIRouter(include_in_schema=False)
# A build of the sources in place, or one without Node, has no page.
NO_PAGE = "this installation has no page; install a wheel of midspan, or run `make page` in its sources"


@no_page.get("/")
async def explain() -> PlainTextResponse:
    """Why there is no page."""
    return PlainTextResponse(f"midspan: {NO_PAGE}. The REST interface is at {API}.\n", status_code=503)


page = APIRouter(include_in_schema=False)


@page.get("/")
async def index() -> FileResponse:
    """The page, whose views are named behind #."""
    return FileResponse(PAGE / "index.html")


@page.get("/icon.svg")
async def icon() -> FileResponse:
    """The page's icon."""
    return FileResponse(PAGE / "icon.svg")


routes = APIRouter(tags=["health"])


@routes.get("/healthz", include_in_schema=False)
async def healthz() -> PlainTextResponse:
    """Whether the process lives."""
    return PlainTextResponse("ok\n")


@routes.get("/readyz", include_in_schema=False)
async def readyz(serving: Shared) -> JSONResponse:
    """Whether everything measures, and if not, why."""
    now = serving.standing()
    return JSONResponse(now, status_code=200 if now["ready"] else 503)


@routes.get("/metrics", include_in_schema=False)
async def metrics(serving: Shared) -> PlainTextResponse:
    """Figures for Prometheus."""
    return PlainTextResponse(figures(serving), media_type="text/plain; version=0.0.4")


@routes.get(f"{API}/health", response_model=Standing, dependencies=READ, responses=problems.declared(401, 403))
async def standing(serving: Shared) -> Tree:
    """How points, sources and settings stand."""
    return serving.standing()


description = APIRouter(tags=["health"])


@description.get(
    f"{API}/openapi.json", response_model=dict[str, Any], dependencies=READ, responses=problems.declared(401, 403)
)
async def openapi(request: Request) -> JSONResponse:
    """This interface as OpenAPI 3.1."""
    return JSONResponse(request.app.openapi())


def _interface(app: FastAPI) -> dict[str, Any]:
    """The interface's description, with the problems' schema, which no route names as its own answer."""
    if app.openapi_schema is None:
        made = get_openapi(title=app.title, version=app.version, routes=app.routes, openapi_version="3.1.0")
        schemas = made.setdefault("components", {}).setdefault("schemas", {})
        schemas["ProblemBody"] = problems.ProblemBody.model_json_schema()
        app.openapi_schema = made
    return app.openapi_schema
