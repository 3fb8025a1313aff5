"""The application: the interface below /api/v1, health without a login, and the page's own files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse, PlainTextResponse
from pydantic import BaseModel, Field
from starlette.staticfiles import StaticFiles

from midspan._version import __version__
from midspan.serve import live, login, points, problems, settings_file, sources
from midspan.serve.limits import Limits
from midspan.serve.login import Guard
from midspan.serve.metrics import figures
from midspan.serve.serving import Serving
from midspan.service.live_socket import Tree

API = "/api/v1"
# Where the page's files are shipped, once they are built.
PAGE = Path(__file__).parent / "page"
ROUTERS: tuple[Callable[[Serving, Guard], APIRouter], ...] = (
    login.router, points.router, sources.router, settings_file.router, live.router,
)  # fmt: skip
"""One function a part of the interface; another part is another row."""


class Standing(BaseModel):
    """As /readyz shows it; settings: what is wrong with SITE.toml, null where nothing is."""

    ready: bool
    points: list[dict[str, Any]]
    sources: list[dict[str, Any]]
    settings: dict[str, Any] | None = Field(None, description="text, file and key of what is wrong with SITE.toml")


def application(serving: Serving) -> Any:
    """The ASGI application over a store."""
    app = FastAPI(title="midspan", version=__version__, docs_url=None, redoc_url=None, openapi_url=None)
    guard = Guard(serving)
    problems.install(app)
    for make in ROUTERS:
        app.include_router(make(serving, guard), prefix=API)
    health(app, serving, guard)
    app.openapi = lambda: _interface(app)  # type: ignore[method-assign]
    if PAGE.is_dir():
        app.mount("/", StaticFiles(directory=PAGE, html=True))
    return Limits(app)


def health(app: FastAPI, serving: Serving, guard: Guard) -> None:
    """How all stands: for programs without a login, for the page with one."""

    @app.get("/healthz", include_in_schema=False)
    async def healthz() -> PlainTextResponse:
        return PlainTextResponse("ok\n")

    @app.get("/readyz", include_in_schema=False)
    async def readyz() -> JSONResponse:
        now = serving.standing()
        return JSONResponse(now, status_code=200 if now["ready"] else 503)

    @app.get("/metrics", include_in_schema=False)
    async def metrics() -> PlainTextResponse:
        return PlainTextResponse(figures(serving), media_type="text/plain; version=0.0.4")

    @app.get(
        f"{API}/health", response_model=Standing, tags=["health"], dependencies=[guard.require("read")],
        responses=problems.declared(401, 403),
    )  # fmt: skip
    async def standing() -> Tree:
        """How points, sources and settings stand."""
        return serving.standing()

    @app.get(
        f"{API}/openapi.json", tags=["health"], dependencies=[guard.require("read")],
        responses=problems.declared(401, 403), response_model=dict[str, Any],
    )  # fmt: skip
    async def openapi() -> JSONResponse:
        """This interface as OpenAPI 3.1."""
        return JSONResponse(app.openapi())


def _interface(app: FastAPI) -> dict[str, Any]:
    """The interface's description, with the problems' schema, which no route names as its own answer."""
    if app.openapi_schema is None:
        made = get_openapi(title=app.title, version=app.version, routes=app.routes, openapi_version="3.1.0")
        schemas = made.setdefault("components", {}).setdefault("schemas", {})
        schemas["ProblemBody"] = problems.ProblemBody.model_json_schema()
        app.openapi_schema = made
    return app.openapi_schema
