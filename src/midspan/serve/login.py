"""Login by password, sessions in a cookie, tokens; who may do what."""

from typing import Annotated, Any, Literal, Protocol

from fastapi import APIRouter, Depends, Request, Response
from fastapi.responses import JSONResponse
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import HTTPConnection

from midspan.serve.access import SESSION_S, Login, csrf_of, password_matches
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Shared

COOKIE = "midspan_session"
CSRF_HEADER = "X-CSRF-Token"
# What the password of nobody is compared with, so that a user who does not exist takes as long as one who does: a hash
# of 256 random bits that were not kept, with argon2's usual figures.
NOBODY = "$argon2id$v=19$m=65536,t=3,p=4$Uf9RQLaI5bn2TSWjkvSeng$SuPEoFcqjKMqjDHZDeQ87yDAsUSkEQvbuYURJ8iLM5M"
CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})

Scope = Literal["read", "operate", "admin"]


class Credentials(BaseModel):
    """A user's name and password."""

    model_config = ConfigDict(extra="forbid")
    user: str = Field(min_length=1, max_length=64)
    password: str = Field(min_length=1, max_length=256)


class Session(BaseModel):
    """Who is logged in; `csrf` is sent back as X-CSRF-Token with whatever changes something (empty for a token)."""

    user: str
    scope: Scope
    csrf: str
    serves: Literal["site", "recordings"] = Field("site", description="what the page serves")


class Gate(Protocol):
    """Who may come in. how: what to do without a login, with a code for the page; serves: what is behind it."""

    how: str
    code: str
    serves: Literal["site", "recordings"]

    def of_token(self, token: str) -> Login | None:
        """Whose token it is."""

    def of_session(self, session: str) -> Login | None:
        """Whose session it is."""


# The session's cookie is the page's, and stands in no description: one way for scripts is enough.
TokenScheme = HTTPBearer(auto_error=False, scheme_name="token")


def gate_of(connection: HTTPConnection) -> Gate:
    """Who may come in to what an application serves."""
    gate: Gate = connection.app.state.serving.access
    return gate


def login_of(connection: HTTPConnection) -> tuple[Login, str]:
    """Who asks, and the session ("" for a token). Raises Problem 401."""
    gate = gate_of(connection)
    kind, _, token = connection.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        login = gate.of_token(token.strip())
        if login is not None:
            return login, ""
    elif session := connection.cookies.get(COOKIE, ""):
        login = gate.of_session(session)
        if login is not None:
            return login, session
    raise Problem(401, gate.how, headers={"WWW-Authenticate": "Bearer"}, code=gate.code)


def require(scope: Scope) -> Any:
    """A dependency of routes that need a scope; with a session, changes need its CSRF token."""

    async def allowed(
        request: Request,
        _token: Annotated[HTTPAuthorizationCredentials | None, Depends(TokenScheme)],
    ) -> Login:
        login, session = login_of(request)
        if session and request.method in CHANGING and request.headers.get(CSRF_HEADER) != csrf_of(session):
            raise Problem(403, f"{CSRF_HEADER}: must be the `csrf` value of the login. Send it with every change.")
        if not login.may(scope):
            raise Problem(403, f"This needs the scope {scope}; {login.name} has {login.scope}.")
        return login

    return Depends(allowed)


READ, OPERATE, ADMIN = [require("read")], [require("operate")], [require("admin")]
"""What routes depend on, by the scope that they need."""
Operator = Annotated[Login, OPERATE[0]]
"""A parameter of routes that need to know who commands."""

routes = APIRouter(tags=["access"])
# What goes with users and passwords alone.
passwords = APIRouter(tags=["access"])


@passwords.post("/login", response_model=Session, responses=declared(401, 413, 415, 422))
async def begin(credentials: Credentials, request: Request, response: Response, serving: Shared) -> Session:
    """Begin a session, which the cookie holds."""
    user, address = credentials.user, request.client.host if request.client else ""
    attempts = serving.attempts
    wait_s = attempts.wait_s(user, address)
    if wait_s > 0.0:
        text = f"Too many logins failed for this user, or from this address. Try again in {wait_s:.0f} s."
        raise Problem(429, text, headers={"Retry-After": str(round(wait_s) + 1)})
    attempts.failed(user, address)
    kept = serving.access.kept_password(user)
    matches = await serving.hashing.run(password_matches, kept or NOBODY, credentials.password)
    if kept is None or not matches:
        raise Problem(401, "User or password is wrong.", headers={"WWW-Authenticate": "Bearer"})
    attempts.succeeded(user, address)
    session = serving.access.begin_session(user)
    found = serving.access.of_session(session)
    if found is None:
        raise Problem(401, "The user has been removed.", headers={"WWW-Authenticate": "Bearer"})
    response.set_cookie(
        COOKIE, session, max_age=round(SESSION_S), httponly=True, samesite="strict", secure=serving.secure, path="/"
    )
    return Session.model_validate({"user": user, "scope": found.scope, "csrf": csrf_of(session)})


@routes.get("/session", response_model=Session, responses=declared(401), dependencies=[Depends(TokenScheme)])
async def session(request: Request) -> Session | JSONResponse:
    """Who is logged in, with the CSRF token: a page that was loaded again asks for it."""
    gate = gate_of(request)
    try:
        found, kept = login_of(request)
    except Problem:
        # The page's own way to ask, `?optional=true`: browsers report a 401 as a fault.
        if request.query_params.get("optional") == "true":
            return JSONResponse({"user": None, "text": gate.how, "code": gate.code})
        raise
    csrf, serves = csrf_of(kept) if kept else "", gate.serves
    return Session.model_validate({"user": found.name, "scope": found.scope, "csrf": csrf, "serves": serves})


@passwords.post("/logout", status_code=204, responses=declared(401, 403), dependencies=READ)
async def end(request: Request, response: Response, serving: Shared) -> None:
    """End the session."""
    serving.access.end_session(request.cookies.get(COOKIE, ""))
    response.delete_cookie(COOKIE, path="/")
