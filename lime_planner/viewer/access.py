"""Who may open the page's socket, and who may do more than look.

A web page of any origin can make a browser talk to a port of the user's own machine. Two headers that a page cannot forge tell such
a request from our own page's: `Host` names the server that the browser believes it talks to (a foreign name that was made to
resolve to this machine shows there), and `Origin` names the page that opens the socket. We take only hosts that we know, and only
sockets opened by the page that was served under that very host.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from lime_planner.core.errors import ParameterError

COOKIE = "lime_planner_token"
LOOPBACK = ("127.0.0.1", "::1", "localhost")
MIN_TOKEN_LENGTH = 8


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Attributes:
        host: address that the server is bound to.
        token: what a browser must know to operate the page from another machine; empty: it cannot be operated from there.
    """

    host: str = "127.0.0.1"
    token: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        """Check the token.

        Raises:
            ParameterError: a token that is too short or that a URL cannot carry.
        """
        if self.token and not re.fullmatch(rf"[A-Za-z0-9_.~-]{{{MIN_TOKEN_LENGTH},}}", self.token):
            raise ParameterError(f"--allow-motion needs a token of at least {MIN_TOKEN_LENGTH} letters, digits and - _ . ~")

    @property
    def local(self) -> bool:
        """Whether only this machine can reach the server."""
        return self.host in LOOPBACK

    def url(self, port: int) -> str:
        """Return the page's address, with the token where one is needed."""
        name = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        name = f"[{name}]" if ":" in name else name
        return f"http://{name}:{port}/" + (f"?token={self.token}" if self.token and not self.local else "")

    def refusal(self, headers: Mapping[str, str], *, websocket: bool) -> str | None:
        """Return why a request is not served, in a sentence, or None.

        Args:
            headers: of the request.
            websocket: whether it asks for the socket; then it must come from our own page.
        """
        host = headers.get("Host", "")
        if not self._known(host):
            return f"This server does not serve the host {host or 'that was not named'!r}."
        if not websocket:
            return None
        origin = headers.get("Origin", "")
        # TLS, where there is any, ends at a proxy in front of us.
        if origin not in (f"http://{host}", f"https://{host}"):
            return f"The page at {origin or 'no origin'!r} may not use the planner at {host!r}."
        return None

    def operates(self, headers: Mapping[str, str]) -> bool:
        """Tell whether a browser may do more than look: on this machine always, from elsewhere only with the token."""
        if self.local:
            return True
        try:
            morsel = SimpleCookie(headers.get("Cookie", "")).get(COOKIE)
        except CookieError:
            return False
        return bool(self.token) and morsel is not None and hmac.compare_digest(morsel.value, self.token)

    def cookie(self, path: str) -> str | None:
        """Return the cookie to set for a request whose address brings the right token (`/?token=...`), or None."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if not self.token or not hmac.compare_digest(given.encode(), self.token.encode()):
            return None
        return f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"

    def _known(self, host: str) -> bool:
        """Whether a `Host` header names this server: loopback, and when bound elsewhere any address or this machine's own names."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in LOOPBACK:
            return True
        if self.local:
            return False
        try:
            ipaddress.ip_address(name)
            return True  # an address was not resolved by a name server
        except ValueError:
            own = socket.gethostname().lower()
            return name in (own, own.split(".")[0], f"{own.split('.')[0]}.local", socket.getfqdn().lower(), self.host.lower())
