"""Who may come in: whoever has a link that was printed for the person who started the command.

A link is changed once for a token, which the page keeps and sends as a header. No cookie: browsers send cookies to
every port of a host, so that a server of another user of this machine could take them; what a page keeps for itself
belongs to one port alone. Nothing is kept on disk, and all of it ends with the process.
"""

import hashlib
import secrets
from typing import Literal

from midspan.serve.access import Login

# 256 random bits.
TOKEN_BYTES = 32


class LinkAccess:
    """Links that work once, and the tokens that they were changed for."""

    how = "Open the link that `midspan open` printed. Each works once; Enter in its terminal prints another."
    code = "link"
    serves: Literal["site", "recordings"] = "recordings"

    def __init__(self) -> None:
        # Of what a comparison of texts could leak by its time, only sums are compared.
        self._links: set[bytes] = set()
        self._tokens: set[bytes] = set()

    def link(self) -> str:
        """The secret of a new link; those before it, which nobody used, still work."""
        secret = secrets.token_urlsafe(TOKEN_BYTES)
        self._links.add(_digest(secret))
        return secret

    def changed(self, link: str) -> str | None:
        """The token for a link, which works no more; None for one that does not."""
        if _digest(link) not in self._links:
            return None
        self._links.discard(_digest(link))
        token = secrets.token_urlsafe(TOKEN_BYTES)
        self._tokens.add(_digest(token))
        return token

    def of_token(self, token: str) -> Login | None:
        """Whoever has a token may do everything: it is the person who started the command."""
        return Login("you", "token", "admin") if _digest(token) in self._tokens else None

    def of_session(self, session: str) -> Login | None:
        """There are no cookies."""
        return None


def _digest(secret: str) -> bytes:
    return hashlib.sha256(secret.encode()).digest()
