"""Who may speak to the page, and what is heard: checked before viser sees a request or a message.

viser serves whoever reaches its port, with any `Origin` and `Host`: a website that somebody opens
on this machine would have the controls of the arm. Here a request needs

- a `Host` that DNS cannot have led here from elsewhere (DNS rebinding), and an `Origin`, which
  browsers always send with a WebSocket, that is the page's own;
- the page's token as the first part of its path, which viser's client hands on to its WebSocket.

Of what a browser sends then, viser gets the camera and values of controls, each a finite number
or a short text: no uploads, no requests to share the page, no other properties.
"""

from __future__ import annotations

import contextlib
import io
import ipaddress
import math
import secrets
import socket
from collections.abc import Callable
from dataclasses import replace
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import msgspec
import viser
import websockets.asyncio.server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from cablesense_base import CableSenseError

MOST_CLIENTS = 10
"""Browsers that are served at a time, the one that commands among them."""
MOST_MESSAGE_BYTES = 16_384
"""Camera and values of controls take some hundred."""
PING_EVERY_S, SILENT_S = 5.0, 10.0
"""A browser that does not answer for so long has left: its force is taken off."""
_LONGEST_TEXT = 100

Answer = Callable[[ServerConnection, Request], Response | None]


class PageError(CableSenseError):
    """The page cannot be served."""


def guarded_server(host: str, port: int, token: str) -> viser.ViserServer:
    """A viser server on `host` from `port` on, for those who have the token.

    viser has no place for such checks, so its call of `websockets` is replaced while it starts.

    Raises:
        PageError: this viser does not make that call, and would serve the page to everyone.
    """
    serve = websockets_server.serve
    guarded = False

    def guarded_serve(handler: Any, *address: Any, **options: Any) -> Any:
        nonlocal guarded
        guarded = "process_request" in options
        checks = {
            "process_request": _checked(options.get("process_request"), host, token),
            "create_connection": _BrowserConnection,
            "max_size": MOST_MESSAGE_BYTES,
            "ping_interval": PING_EVERY_S,
            "ping_timeout": SILENT_S,
        }
        return serve(handler, *address, **options | checks)

    websockets_server.serve = guarded_serve  # type: ignore[assignment,misc]
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, verbose=False)
    finally:
        websockets_server.serve = serve  # type: ignore[misc]
    if not guarded:
        server.stop()
        raise PageError(
            f"viser {viser.__version__} serves in a way that is not guarded, so that any website "
            "could command the arm; install the release that constraints.txt names"
        )
    return server


def _checked(answer: Answer | None, host: str, token: str) -> Answer:
    """What answers requests: refuses them, or hands them to viser without the token."""

    def checked(connection: ServerConnection, request: Request) -> Response | None:
        given, _, path = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not _from_the_page(request.headers, host):
            why = "This Host or Origin is not the page's."
        elif not secrets.compare_digest(given.encode("ascii", "replace"), token.encode()):
            why = "The page opens by the whole address that was printed when it started."
        elif len(connection.server.connections) >= MOST_CLIENTS:
            why = f"{MOST_CLIENTS} browsers show the page already; close one."
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{why}\n")
        else:
            response = answer and answer(connection, replace(request, path=f"/{path}"))
            if response is not None:
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Frame-Options"] = "DENY"
            return response
        return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")

    return checked


def _from_the_page(headers: Headers, host: str) -> bool:
    """Whether a browser that sends these headers shows this page, or is about to open it."""
    asked, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(asked) != 1 or not _is_here(asked[0], host):
        return False
    if not origins:
        return "Upgrade" not in headers
    own = asked[0].lower()
    return len(origins) == 1 and origins[0].lower() in (f"http://{own}", f"https://{own}")


def _is_here(asked: str, host: str) -> bool:
    """Whether a `Host` is an address, or a name that is no other's: what DNS cannot turn."""
    try:
        name = urlsplit(f"//{asked}").hostname or ""
    except ValueError:
        return False
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return name in ("localhost", host.lower(), socket.gethostname().lower())


_Vector = tuple[float, float, float]


class _Camera(msgspec.Struct, tag_field="type", tag="ViewerCameraMessage"):
    wxyz: tuple[float, float, float, float]
    position: _Vector
    fov: float
    near: float
    far: float
    image_height: float
    image_width: float
    look_at: _Vector
    up_direction: _Vector


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | float | str


class _Update(msgspec.Struct, tag_field="type", tag="GuiUpdateMessage"):
    uuid: str
    updates: _Value


_MESSAGES = msgspec.msgpack.Decoder(_Camera | _Update)


class _BrowserConnection(ServerConnection):
    """A browser's connection, of which viser receives what the page has a use for."""

    async def recv(self, decode: bool | None = None) -> Any:
        """The next such message; others are dropped."""
        while not _is_of_use(message := await super().recv(decode)):
            pass
        return message


def _is_of_use(message: str | bytes) -> bool:
    if isinstance(message, str):
        return False
    try:
        read = _MESSAGES.decode(message)
    except msgspec.MsgspecError:
        return False
    if isinstance(read, _Camera):
        return True
    value = read.updates.value
    return len(value) <= _LONGEST_TEXT if isinstance(value, str) else math.isfinite(value)
