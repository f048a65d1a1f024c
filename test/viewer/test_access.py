"""Who may open the page's socket: real handshakes with forged headers, and what a browser that may only look can send."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import viser
from websockets.sync.client import connect

from lime_planner.core.errors import ParameterError
from lime_planner.viewer.access import COOKIE, Access
from lime_planner.viewer.serving import free_port, start_server, stop_server

TOKEN = "correct-horse"


@pytest.fixture(scope="module")
def local() -> Iterator[viser.ViserServer]:
    server = start_server(Access(), 0, label="test")
    yield server
    stop_server(server)


@pytest.fixture(scope="module")
def public() -> Iterator[viser.ViserServer]:
    server = start_server(Access("0.0.0.0", TOKEN), 0, label="test")
    yield server
    stop_server(server)


def request(port: int, *, path: str = "/", **headers: str) -> tuple[int, str]:
    """Send one request as written, and return the status and the head of the answer."""
    lines = [f"GET {path} HTTP/1.1", *(f"{name.replace('_', '-')}: {value}" for name, value in headers.items()), "", ""]
    with socket.create_connection(("127.0.0.1", port), 5.0) as wire:
        wire.sendall("\r\n".join(lines).encode())
        head = b""
        while b"\r\n\r\n" not in head:
            piece = wire.recv(4096)
            if not piece:
                break
            head += piece
    return int(head.split()[1]), head.partition(b"\r\n\r\n")[0].decode()


def handshake(port: int, **headers: str) -> int:
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec_WebSocket_Version": "13",
        "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
        "Sec_WebSocket_Protocol": f"viser-v{viser.__version__}",
    }
    return request(port, **upgrade, **headers)[0]


def test_own_page_opens_the_socket(local: viser.ViserServer) -> None:
    port = local.get_port()
    for name in ("127.0.0.1", "localhost"):
        assert handshake(port, Host=f"{name}:{port}", Origin=f"http://{name}:{port}") == 101


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:1", "http://localhost", "null", "", "http://127.0.0.1.evil.example"]
)
def test_foreign_origin_is_refused(local: viser.ViserServer, origin: str) -> None:
    port = local.get_port()
    assert handshake(port, Host=f"127.0.0.1:{port}", Origin=origin) == 403


def test_missing_origin_is_refused(local: viser.ViserServer) -> None:
    port = local.get_port()
    assert handshake(port, Host=f"127.0.0.1:{port}") == 403


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "192.0.2.7", "[::2]", "", "a:b:c"])
def test_foreign_host_is_refused(local: viser.ViserServer, host: str) -> None:
    """A name that somebody's name server points at this machine; the origin fits it, as a browser would say."""
    port = local.get_port()
    assert handshake(port, Host=f"{host}:{port}", Origin=f"http://{host}:{port}") == 403
    assert request(port, Host=f"{host}:{port}")[0] == 403


def test_page_cannot_be_framed(local: viser.ViserServer) -> None:
    port = local.get_port()
    status, head = request(port, Host=f"127.0.0.1:{port}")
    assert status == 200
    assert "X-Frame-Options: DENY" in head
    assert "frame-ancestors 'none'" in head


def test_bound_to_loopback_only(local: viser.ViserServer, public: viser.ViserServer) -> None:
    bound: dict[int, set[str]] = {}
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        address, _, port = line.split()[1].partition(":")
        if line.split()[3] == "0A":  # listening
            bound.setdefault(int(port, 16), set()).add(address)
    assert bound[local.get_port()] == {"0100007F"}
    assert bound[public.get_port()] == {"00000000"}


def test_token_comes_as_a_cookie(public: viser.ViserServer) -> None:
    port = public.get_port()
    _, head = request(port, path=f"/?token={TOKEN}", Host=f"127.0.0.1:{port}")
    assert f"Set-Cookie: {COOKIE}={TOKEN}; HttpOnly; SameSite=Strict" in head
    _, head = request(port, path="/?token=guess-guess", Host=f"127.0.0.1:{port}")
    assert "Set-Cookie" not in head


def send(server: viser.ViserServer, cookie: str, message: dict[str, object], until: object = None) -> None:
    """Open the socket as our own page would, send a message, and wait until the server has read it."""
    port = server.get_port()
    headers = {"Cookie": f"{COOKIE}={cookie}"} if cookie else {}
    with connect(
        f"ws://127.0.0.1:{port}",
        origin=f"http://127.0.0.1:{port}",  # type: ignore[arg-type]
        subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
        additional_headers=headers,
        compression=None,
    ) as wire:
        wire.send(msgspec.msgpack.encode(message))
        wire.ping().wait(5.0)


def settle(server: viser.ViserServer) -> None:
    """Let the server's loop run what it has queued."""
    import asyncio

    asyncio.run_coroutine_threadsafe(asyncio.sleep(0.05), server.get_event_loop()).result(5.0)


def test_only_who_knows_the_token_operates(public: viser.ViserServer) -> None:
    slider = public.gui.add_slider("test", 0.0, 1.0, 0.1, 0.0)
    message = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 0.5}}
    for cookie in ("", "guess-guess"):
        send(public, cookie, message)
        settle(public)
        assert slider.value == 0.0
    send(public, TOKEN, message)
    settle(public)
    assert slider.value == 0.5


def test_nobody_opens_a_tunnel(local: viser.ViserServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Viser's own share button would put the page on the internet."""
    asked: list[object] = []
    monkeypatch.setattr(local, "request_share_url", lambda *args, **options: asked.append(args))
    slider = local.gui.add_slider("test", 0.0, 1.0, 0.1, 0.0)
    send(local, "", {"type": "ShareUrlRequest"})
    send(local, "", {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 0.5}})
    settle(local)
    assert slider.value == 0.5  # the server still listens
    assert asked == []


def test_rules_of_names() -> None:
    own = socket.gethostname()
    everywhere = Access("0.0.0.0")
    for host in ("192.0.2.7:8080", f"{own}:8080", "[2001:db8::1]:8080"):
        assert everywhere.refusal({"Host": host, "Origin": f"http://{host}"}, websocket=True) is None
    assert everywhere.refusal({"Host": "evil.example", "Origin": "http://evil.example"}, websocket=True) is not None
    assert not everywhere.operates({})
    assert not everywhere.operates({"Cookie": f"{COOKIE}="})
    assert Access().operates({})


@pytest.mark.parametrize("token", ["short", "with space in it", "semi;colon;semi"])
def test_weak_tokens_are_refused(token: str) -> None:
    with pytest.raises(ParameterError, match="token of at least 8"):
        Access("0.0.0.0", token)


def test_taken_port_is_named(local: viser.ViserServer) -> None:
    with pytest.raises(ParameterError, match=f"port {local.get_port()}.*--port"):
        start_server(Access(), local.get_port(), label="second")
    assert free_port("127.0.0.1", local.get_port()) != local.get_port()


def test_unguarded_viser_is_not_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Were viser to open its port in another way, we would rather have no page."""
    import lime_planner.viewer.serving as serving

    monkeypatch.setattr(serving, "_Stand", lambda module, **_: module)
    with pytest.raises(ParameterError, match="cannot be guarded"):
        start_server(Access(), 0, label="test")
