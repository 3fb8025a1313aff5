"""Login by password, sessions in a cookie, tokens; who may do what."""

import time
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Request, Response, WebSocket
from fastapi.security import APIKeyCookie, HTTPAuthorizationCredentials, HTTPBearer
from pydantic import BaseModel, ConfigDict, Field

from midspan.serve.access import SESSION_S, Login, csrf_of, password_hash, password_matches
from midspan.serve.problems import Problem, declared
from midspan.serve.serving import Serving

COOKIE = "midspan_session"
CSRF_HEADER = "X-CSRF-Token"
# Attempts that fail, of a user and from an address, within this time, s: what a person needs, and no list of words.
WINDOW_S, MAX_OF_USER, MAX_OF_ADDRESS = 60.0, 5, 10
# Users and addresses that are remembered.
MAX_REMEMBERED = 10_000
CHANGING = frozenset({"POST", "PUT", "PATCH", "DELETE"})

Scope = Literal["read", "operate", "admin"]


class Attempts:
    """Failed logins by user and by address; an answer is refused while either has too many."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._failed: OrderedDict[tuple[str, str], deque[float]] = OrderedDict()

    def wait_s(self, user: str, address: str) -> float:
        """How long the next attempt has to wait; 0 where it need not."""
        return max(self._wait_s(("user", user), MAX_OF_USER), self._wait_s(("address", address), MAX_OF_ADDRESS))

    def failed(self, user: str, address: str) -> None:
        """An attempt failed, or is being looked at: those at a time are as many as fail."""
        for key in (("user", user), ("address", address)):
            self._failed.setdefault(key, deque()).append(self._now_s())
            self._failed.move_to_end(key)
        while len(self._failed) > MAX_REMEMBERED:
            self._failed.popitem(last=False)

    def succeeded(self, user: str, address: str) -> None:
        """An attempt that was counted as failed did not fail."""
        for key in (("user", user), ("address", address)):
            if self._failed.get(key):
                self._failed[key].pop()

    def _wait_s(self, key: tuple[str, str], most: int) -> float:
        times = self._failed.get(key)
        while times and self._now_s() - times[0] > WINDOW_S:
            times.popleft()
        if not times:
            self._failed.pop(key, None)
            return 0.0
        return WINDOW_S - (self._now_s() - times[0]) if len(times) >= most else 0.0


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


CookieScheme = APIKeyCookie(name=COOKIE, auto_error=False, scheme_name="session")
TokenScheme = HTTPBearer(auto_error=False, scheme_name="token")


class Guard:
    """Lets requests pass that may do what they ask for."""

    def __init__(self, serving: Serving) -> None:
        self._serving = serving
        self.attempts = Attempts()

    def of(self, connection: Request | WebSocket) -> tuple[Login, str]:
        """Who asks, and the session ("" for a token). Raises Problem 401."""
        kind, _, token = connection.headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer":
            login = self._serving.access.of_token(token.strip())
            if login is not None:
                return login, ""
        elif session := connection.cookies.get(COOKIE, ""):
            login = self._serving.access.of_session(session)
            if login is not None:
                return login, session
        text = "Log in (POST /api/v1/login), or send Authorization: Bearer TOKEN."
        raise Problem(401, text, headers={"WWW-Authenticate": "Bearer"})

    def require(self, scope: Scope) -> Any:
        """A dependency of routes that need a scope; with a session, changes need its CSRF token."""

        def allowed(
            request: Request,
            _cookie: Annotated[str | None, Depends(CookieScheme)],
            _token: Annotated[HTTPAuthorizationCredentials | None, Depends(TokenScheme)],
        ) -> Login:
            login, session = self.of(request)
            if session and request.method in CHANGING and request.headers.get(CSRF_HEADER) != csrf_of(session):
                raise Problem(403, f"{CSRF_HEADER}: must be the `csrf` that the login answered. Send it with changes.")
            if not login.may(scope):
                raise Problem(403, f"This needs the scope {scope}; {login.name} has {login.scope}.")
            return login

        return Depends(allowed)


def router(serving: Serving, guard: Guard) -> APIRouter:
    """The routes of logins and sessions."""
    routes = APIRouter(tags=["access"])
    nobody: list[str] = []

    @routes.post("/login", response_model=Session, responses=declared(401, 413, 415, 422))
    async def login(credentials: Credentials, request: Request, response: Response) -> Session:
        """Begin a session, which the cookie holds."""
        user, address = credentials.user, request.client.host if request.client else ""
        wait_s = guard.attempts.wait_s(user, address)
        if wait_s > 0.0:
            text = f"Too many logins failed for this user, or from this address. Try again in {wait_s:.0f} s."
            raise Problem(429, text, headers={"Retry-After": str(round(wait_s) + 1)})
        guard.attempts.failed(user, address)
        if not nobody:
            # A user who does not exist takes as long as one who does.
            nobody.append(await serving.hashing.run(password_hash, "nobody"))
        kept = serving.access.kept_password(user)
        matches = await serving.hashing.run(password_matches, kept or nobody[0], credentials.password)
        if kept is None or not matches:
            raise Problem(401, "User or password is wrong.", headers={"WWW-Authenticate": "Bearer"})
        guard.attempts.succeeded(user, address)
        session = serving.access.begin_session(user)
        found = serving.access.of_session(session)
        if found is None:
            raise Problem(401, "The user was removed meanwhile.", headers={"WWW-Authenticate": "Bearer"})
        response.set_cookie(
            COOKIE, session, max_age=round(SESSION_S), httponly=True, samesite="strict", secure=serving.secure, path="/"
        )
        return Session.model_validate({"user": user, "scope": found.scope, "csrf": csrf_of(session)})

    @routes.get("/session", response_model=Session, responses=declared(401))
    async def session(request: Request, _: Annotated[Login, guard.require("read")]) -> Session:
        """Who is logged in, with the CSRF token: a page that was loaded again asks for it."""
        found, kept = guard.of(request)
        return Session.model_validate({"user": found.name, "scope": found.scope, "csrf": csrf_of(kept) if kept else ""})

    @routes.post("/logout", status_code=204, responses=declared(401, 403))
    async def logout(request: Request, response: Response, _: Annotated[Login, guard.require("read")]) -> None:
        """End the session."""
        serving.access.end_session(request.cookies.get(COOKIE, ""))
        response.delete_cookie(COOKIE, path="/")

    return routes
