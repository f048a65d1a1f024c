"""Viser's server, bound to loopback unless told otherwise, with the rules of `lime_planner.viewer.access` in front of it.

Viser itself looks at neither `Host` nor `Origin`, and takes every message from every browser. Its one way in is the `serve` of the
library websockets, which it looks up when it starts: while it does, we hand it ours. Ours asks `Access` before the handshake, and
passes messages on only from browsers that may operate the page; the others can look and move their own camera. A version of
viser that opens its port in another way is not served at all.
"""

from __future__ import annotations

import asyncio
import contextlib
import http
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import Any
from urllib.parse import urlsplit

from lime_planner.core.errors import ParameterError
from lime_planner.core.signals import EndSignals
from lime_planner.viewer.access import Access
from lime_planner.viewer.head import with_our_head

_starting = threading.Lock()
#: Messages that show something to their sender alone. Everything else changes what all browsers see, or moves an arm.
_LOOKING = ("ViewerCameraMessage",)
#: Messages that no browser may send: they would open a tunnel to a server on the internet.
_NEVER = ("ShareUrlRequest", "ShareUrlDisconnect")
_PORTS_TRIED = 20
_HEADERS = {
    "X-Frame-Options": "DENY",  # no other page may lay ours under the user's clicks
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",  # the address may hold the token
    "Cache-Control": "no-store",
}


#: Paths, and what answers to the query of each.
Answers = Mapping[str, Callable[[str], str | None]]


class _Stand:
    """Stands in for a module: some names replaced, all others the module's own."""

    def __init__(self, module: Any, **replaced: Any) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def free_port(host: str, port: int, *, tries: int = _PORTS_TRIED) -> int:
    """Return the first port from `port` on that can be bound at `host`; 0 lets the system choose.

    Raises:
        ParameterError: none of `tries` ports is free, or the host is not an address of this machine.
    """
    reason = ""
    for candidate in range(port, min(port + max(tries, 1), 65536)):
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
                return int(probe.getsockname()[1])
        except OSError as error:
            reason = error.strerror or str(error)
    last = f" to {port + tries - 1}" if tries > 1 else ""
    raise ParameterError(f"the page cannot be served at {host}, port {port}{last}: {reason}; choose another with --port")


def start_server(access: Access, port: int, *, label: str, answers: Answers | None = None) -> Any:
    """Start viser's server (a `viser.ViserServer`) behind the rules.

    Args:
        access: who may do what; its host is what the server binds to.
        port: where to listen.
        label: heads the page's controls.
        answers: what is told at further addresses, to those who may look: path and what makes JSON of the query, None for nothing
            there; called from threads of their own.

    Raises:
        ParameterError: the port is taken, or the installed viser cannot be guarded.
    """
    import viser
    import websockets
    from viser.infra import _infra as viser_infra

    infra: Any = viser_infra
    guards: list[Any] = []

    def serve(handler: Callable[[Any], Awaitable[None]], *args: Any, process_request: Any = None, **options: Any) -> Any:
        guards.append(handler)
        return websockets.asyncio.server.serve(
            _filtered(handler, access), *args, process_request=_guarded(process_request, access, answers or {}), **options
        )

    port = free_port(access.host, port, tries=1)
    with _starting:
        real = infra.websockets
        inner = _Stand(real.asyncio.server, serve=serve)
        infra.websockets = _Stand(real, asyncio=_Stand(real.asyncio, server=inner))
        try:
            with _quiet():
                server = viser.ViserServer(host=access.host, port=port, label=label, verbose=False)
        finally:
            infra.websockets = real
    if not guards:
        stop_server(server)
        raise ParameterError(f"viser {viser.__version__} cannot be guarded against other pages; install viser 1.1")
    return server


def stop_server(server: Any) -> None:
    """Close the port and every browser's connection."""
    with _quiet():
        server.stop()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep viser from printing its own banner and farewell."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _guarded(serve_file: Any, access: Access, answers: Answers) -> Callable[[Any, Any], Any]:
    """Ask `access` before a file is served, a question answered or a socket opened."""
    from websockets import Headers
    from websockets.http11 import Response

    async def process_request(connection: Any, request: Any) -> Any:
        websocket = "websocket" in request.headers.get("Upgrade", "").lower()
        reason = access.refusal(request.headers, websocket=websocket)
        if reason is not None:
            body = f"{reason}\n".encode()
            headers = Headers(**{"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
        if websocket:
            return None
        address = urlsplit(request.path)
        if address.path in answers:
            said = await asyncio.get_running_loop().run_in_executor(None, answers[address.path], address.query)
            body = ("null" if said is None else said).encode()
            headers = Headers(**{"Content-Type": "application/json", "Content-Length": str(len(body)), **_HEADERS})
            return Response(http.HTTPStatus.OK, "OK", headers, body)
        response = serve_file(connection, request)
        if response is not None:
            _dress(response)
            response.headers.update(_HEADERS)
            cookie = access.cookie(request.path)
            if cookie is not None:
                response.headers["Set-Cookie"] = cookie
        return response

    return process_request


def _dress(response: Any) -> None:
    """Put our own head into viser's page; other files pass as they are."""
    if response.status_code != http.HTTPStatus.OK or "html" not in response.headers.get("Content-Type", ""):
        return
    response.body = with_our_head(response.body, gzipped=response.headers.get("Content-Encoding", "") == "gzip")
    if "Content-Length" in response.headers:
        del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


def _filtered(handler: Callable[[Any], Awaitable[None]], access: Access) -> Callable[[Any], Awaitable[None]]:
    """Keep from viser what a browser may not send."""
    import msgspec

    def kind(raw: Any) -> str:
        try:
            return str(msgspec.msgpack.decode(raw)["type"])
        except (msgspec.MsgspecError, KeyError, TypeError):
            return ""

    async def handle(connection: Any) -> None:
        operates = access.operates(connection.request.headers)
        receive = connection.recv

        async def recv(*args: Any, **options: Any) -> Any:
            while True:
                raw = await receive(*args, **options)
                name = kind(raw)
                if name in _LOOKING or (operates and name and name not in _NEVER):
                    return raw

        connection.recv = recv
        await handler(connection)

    return handle


DEFAULT_PORT = 8080


def announce(url: str, access: Access, *, open_browser: bool) -> None:
    """Say where the page is, and open it where there is a desktop."""
    print(f"the page is at {url}   (Ctrl-C ends it)", flush=True)
    if not access.local:
        who = "browsers that open this very address may use the buttons" if access.token else "they may look only"
        print(f"other machines can open it; {who}", flush=True)
    if open_browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or sys.platform == "darwin"):
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(url)


@contextlib.contextmanager
def until_signal() -> Iterator[EndSignals]:
    """Yield what waits for the first Ctrl-C or SIGTERM."""
    signals = EndSignals()
    try:
        yield signals
    finally:
        signals.close()
