"""What goes for every request: how much it may send, and the headers of every answer."""

from typing import Any

from midspan.serve.problems import Problem, answer

# Of SITE.toml, the largest that is sent, there are 100 lines a point at most.
MAX_BODY_BYTES = 1_000_000
MAX_PATH_BYTES, MAX_HEADER_BYTES = 4096, 32_768
TOO_LARGE = f"The content must have at most {MAX_BODY_BYTES} bytes."
# A page may load and ask this server alone: nothing leaves the host, and no other page frames it.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; font-src 'self'; "
    "connect-src 'self'; manifest-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
)
# No Strict-Transport-Security: it would hold for every other service of the host's name, too.
HEADERS = [
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=()"),
]
NOT_KEPT = (b"cache-control", b"no-store")


class Limits:
    """An application within limits. page: paths below which files may be kept by browsers."""

    def __init__(self, app: Any, page: str = "/assets/") -> None:
        self._app, self._page = app, page

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """An ASGI call."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        extra = HEADERS if scope["path"].startswith(self._page) else [*HEADERS, NOT_KEPT]

        async def sent(message: Any) -> None:
            if message["type"] == "http.response.start":
                own = {name for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(one for one in extra if one[0] not in own)]
            await send(message)

        length = dict(scope["headers"]).get(b"content-length", b"0")
        if len(scope["raw_path"]) + len(scope["query_string"]) > MAX_PATH_BYTES:
            await answer(414, f"The address must have at most {MAX_PATH_BYTES} bytes.")(scope, receive, sent)
            return
        if sum(len(name) + len(value) for name, value in scope["headers"]) > MAX_HEADER_BYTES:
            await answer(431, f"The headers must have at most {MAX_HEADER_BYTES} bytes.")(scope, receive, sent)
            return
        if not length.isdigit() or int(length) > MAX_BODY_BYTES:
            await answer(413, TOO_LARGE, {"Connection": "close"})(scope, receive, sent)
            return
        count = 0

        async def received() -> Any:
            nonlocal count
            message = await receive()
            count += len(message.get("body", b""))
            if count > MAX_BODY_BYTES:
                raise Problem(413, TOO_LARGE, headers={"Connection": "close"})
            return message

        await self._app(scope, received, sent)
