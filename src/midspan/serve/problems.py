"""What is wrong with a request, as `application/problem+json` (RFC 9457)."""

import re
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from midspan.errors import DataError, MidspanError, UsageError
from midspan.serve.engine_link import AwayError
from midspan.store.database import StoreFault

TITLES = {
    400: "The request is not valid HTTP",
    401: "A login is needed",
    403: "Not allowed",
    404: "Not found",
    405: "No such method here",
    409: "Not possible in the current state",
    412: "Changed meanwhile",
    413: "Too large",
    414: "Too long an address",
    415: "Unsupported content type",
    422: "Wrong arguments",
    428: "If-Match is needed",
    429: "Too many requests",
    431: "Too large headers",
    500: "A defect of midspan",
    503: "Not available at present",
}


class ProblemBody(BaseModel):
    """What was wrong: `detail` says what, the rule and what to do; `code` is a reason code where there is one."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    code: str = ""
    file: str | None = Field(None, description="file of wrong settings")
    key: str | None = Field(None, description="key of wrong settings")


class Problem(HTTPException):
    """An answer that is a problem."""

    def __init__(self, status: int, detail: str, *, headers: dict[str, str] | None = None, **more: Any) -> None:
        super().__init__(status, detail, headers)
        self.more = more


def answer(status: int, detail: str, headers: Any = None, **more: Any) -> JSONResponse:
    """The response for a problem."""
    body = ProblemBody(title=TITLES.get(status, "Wrong"), status=status, detail=detail, **more)
    return JSONResponse(
        body.model_dump(exclude_none=True), status, headers=headers, media_type="application/problem+json"
    )


def declared(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Problems as a route of the interface declares them."""
    schema = {"schema": {"$ref": "#/components/schemas/ProblemBody"}}
    return {
        status: {"description": TITLES[status], "content": {"application/problem+json": schema}}
        for status in sorted({*statuses, 400, 429, 503})
    }


def install(app: FastAPI) -> None:
    """Let every error of an application be a problem."""

    @app.exception_handler(HTTPException)
    async def of_http(request: Request, error: HTTPException) -> JSONResponse:
        more = error.more if isinstance(error, Problem) else {}
        headers = {"Allow": allowed(request)} if error.status_code == 405 else error.headers
        return answer(error.status_code, str(error.detail), headers, **more)

    @app.exception_handler(RequestValidationError)
    async def of_arguments(_: Request, error: RequestValidationError) -> JSONResponse:
        return answer(422, "; ".join(_sentence(one) for one in error.errors()[:5]))

    @app.exception_handler(MidspanError)
    async def of_midspan(_: Request, error: MidspanError) -> JSONResponse:
        if isinstance(error, AwayError):
            return answer(503, str(error), {"Retry-After": "5"}, code="not_measuring")
        if isinstance(error, StoreFault):
            return answer(503, str(error), {"Retry-After": "5"}, code=error.code)
        return answer(422 if isinstance(error, (UsageError, DataError)) else 409, str(error))

    @app.exception_handler(Exception)
    async def of_defect(_: Request, error: Exception) -> JSONResponse:
        return answer(500, f"This is a defect of midspan ({type(error).__name__}); see its log.")


def allowed(request: Request) -> str:
    """The methods that a request's path has; those that are in no description are for reading."""
    paths = request.app.openapi()["paths"]
    found = [of for path, of in paths.items() if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", path), request.url.path)]
    return ", ".join(sorted({method.upper() for methods in found for method in methods} or {"GET"}))


def _sentence(error: Any) -> str:
    """An argument's name, the rule, what was received."""
    name = ".".join(str(part) for part in error["loc"][1:]) or "body"
    received = repr(error.get("input"))[:80]
    return f"{name}: {error['msg']}; received {received}"
