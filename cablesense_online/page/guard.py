"""Checks of requests and messages to the page, before viser sees them.

viser serves whoever reaches its port, with any `Origin` and `Host`: a website that somebody opens
on this machine would have the controls of the arm. Here a request needs

- a `Host` that DNS cannot have led here from elsewhere (DNS rebinding), and an `Origin`, which
  browsers always send with a WebSocket, that is the page's own;
- the page's token as the first part of its path, which viser's client hands on to its WebSocket.
  There the name of the visitor follows, a random one of each tab, by which a reload is known.

From a browser that passes, viser gets the camera, values of controls, each a finite number or the
number of a segment as text, and clicks and drags on the arm. Uploads, requests to share the page
and other properties are dropped. The first bad value of a browser is logged.
"""

from __future__ import annotations

import contextlib
import io
import ipaddress
import logging
import math
import re
import secrets
import socket
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import replace
from http import HTTPStatus
from importlib.resources import files
from typing import Annotated, Any, Literal
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
PING_EVERY_S = 5.0
"""How often a browser is asked whether it is there: twice in `SILENT_S`."""
SILENT_S = 10.0
"""A browser that does not answer for so long has left: its force is taken off."""
_FARTHEST_M = 1e3
"""How far from the base a drag may lead: no arm is as long."""
_PORT_TRIES = 20
"""Ports that are tried in turn where the first is in use."""
_VISITOR = re.compile(r"[A-Za-z0-9-]{1,64}")
"""Names of visitors."""
_TITLE = b"<title>Viser</title>"
"""What the page's own head takes the place of."""

present_visitor: ContextVar[str] = ContextVar("present_visitor", default="")
"""While a message of a browser is handled, the name of its visitor; empty where it gave none."""

Answer = Callable[[ServerConnection, Request], Response | None]


class PageError(CableSenseError):
    """The page cannot be served."""


def exposure_warning(host: str, port: int, controls: bool) -> str:
    """A warning that others reach a page served on `host`; empty if this machine alone does."""
    with contextlib.suppress(ValueError):  # a name other than localhost may lead anywhere
        if host == "localhost" or ipaddress.ip_address(host).is_loopback:
            return ""
    what = "see and move the arm" if controls else "see the arm"
    return (
        f"the page is served on {host}, port {port}, without encryption: whoever is given its "
        f"address, or listens in on the way, can {what}"
    )


def free_port(host: str, port: int) -> int:
    """The first port from `port` on that can be bound on `host`.

    Raises:
        PageError: the host is not of this machine, or no port is free.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    problem = ""
    for candidate in range(port, min(port + _PORT_TRIES, 65_536)):
        try:
            with socket.create_server((host, candidate), family=family):
                return candidate
        except OSError as error:
            problem = str(error)
    raise PageError(
        f"the page cannot be served on {host}, ports {port} to {port + _PORT_TRIES - 1} "
        f"({problem}); give another --host or --port"
    )


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

        async def handle(connection: ServerConnection) -> None:
            request = connection.request
            present_visitor.set(_visitor(request.path) if request else "")
            await handler(connection)

        return serve(handle, *address, **options | checks)

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
    script = files("cablesense_online.page").joinpath("page.js").read_bytes()
    head = b"<title>CableSense</title><script>" + script + b"</script>"

    def checked(connection: ServerConnection, request: Request) -> Response | None:
        given_token, path = _parts(request.path)
        if not _from_the_page(request.headers, host):
            why = "This Host or Origin is not the page's."
        elif not secrets.compare_digest(given_token.encode("ascii", "replace"), token.encode()):
            why = "The page opens by the whole address that was printed when it started."
        elif len(connection.server.connections) >= MOST_CLIENTS:
            why = f"{MOST_CLIENTS} browsers show the page already; close one."
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{why}\n")
        else:
            headers = request.headers.copy()
            headers.pop("Accept-Encoding", None)  # what is not packed can be given a head
            given_on = replace(request, path=f"/{path}", headers=headers)
            response = answer and answer(connection, given_on)
            if response is not None:
                if _TITLE in response.body:
                    response.body = response.body.replace(_TITLE, head)
                    del response.headers["Content-Length"]
                    response.headers["Content-Length"] = str(len(response.body))
                response.headers["Referrer-Policy"] = "no-referrer"
                response.headers["X-Frame-Options"] = "DENY"
            return response
        return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")

    return checked


def _parts(target: str) -> tuple[str, str]:
    """The first part of a request's path, and the rest."""
    first, _, rest = target.partition("?")[0].removeprefix("/").partition("/")
    return first, rest


def _visitor(target: str) -> str:
    """The visitor's name in a WebSocket's path; empty where there is none."""
    _, name = _parts(target)
    return name if _VISITOR.fullmatch(name) else ""


def _from_the_page(headers: Headers, host: str) -> bool:
    """Whether a browser that sends these headers shows this page, or is about to open it."""
    asked = headers.get_all("Host")
    origins = headers.get_all("Origin")
    if len(asked) != 1 or not _is_here(asked[0], host):
        return False
    if not origins:
        return "Upgrade" not in headers
    site = asked[0].lower()
    return len(origins) == 1 and origins[0].lower() in (f"http://{site}", f"https://{site}")


def _is_here(asked: str, host: str) -> bool:
    """Whether a `Host` is an address, or a name that is no other's: what DNS cannot turn."""
    try:
        name = urlsplit(f"//{asked}").hostname or ""
    except ValueError:
        return False
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    return name in ("localhost", host.lower(), socket.gethostname().lower())


class _Camera(msgspec.Struct, tag_field="type", tag="ViewerCameraMessage"):
    """Where the browser looks from."""


_Short = Annotated[str, msgspec.Meta(max_length=100)]
_Segment = Annotated[str, msgspec.Meta(pattern=r"^[1-9][0-9]{0,3}\Z")]
_Vector = tuple[float, float, float]


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | float | _Segment


class _Update(msgspec.Struct, tag_field="type", tag="GuiUpdateMessage"):
    uuid: str
    updates: _Value


class _Click(msgspec.Struct, tag_field="type", tag="SceneNodeClickMessage"):
    """The ray from the eye through a part of the scene."""

    name: _Short
    ray_origin: _Vector
    ray_direction: _Vector
    screen_pos: tuple[float, float]
    instance_index: None
    modifier: None
    owner: _Short = ""


_Near = Annotated[float, msgspec.Meta(ge=-_FARTHEST_M, le=_FARTHEST_M)]
_Point = tuple[_Near, _Near, _Near]


class _Drag(msgspec.Struct, tag_field="type", tag="SceneNodeDragMessage"):
    """The mouse drags a part of the scene from a point to another, in metres."""

    phase: Literal["start", "update", "end"]
    name: _Short
    start_position: _Point
    end_position: _Point
    start_screen_pos: tuple[float, float]
    end_screen_pos: tuple[float, float]
    instance_index: None
    button: Literal["left"]
    modifier: None
    owner: _Short = ""


_MESSAGES = msgspec.msgpack.Decoder(_Camera | _Update | _Click | _Drag)


class _BrowserConnection(ServerConnection):
    """A browser's connection, of which viser receives what the page has a use for."""

    _told = False

    async def recv(self, decode: bool | None = None) -> Any:
        """The next such message; others are dropped."""
        while (fault := _fault(message := await super().recv(decode))) is not None:
            if fault and not self._told:
                self._told = True
                logging.getLogger(__name__).warning("the page drops a browser's value: %s", fault)
        return message


def _fault(message: str | bytes) -> str | None:
    """The fault of a message: empty of a kind that is not used, None where there is none."""
    if isinstance(message, str):
        return ""
    try:
        read = _MESSAGES.decode(message)
    except msgspec.MsgspecError as error:
        return "" if "`$.type`" in str(error) else ascii(str(error)[:100])
    match read:
        case _Update(updates=_Value(value=float(value))) if not math.isfinite(value):
            return f"{value} is not finite"
        case _Click() if not all(map(math.isfinite, (*read.ray_origin, *read.ray_direction))):
            return "a click from or in a direction that is not finite"
        case _Drag() if not all(map(math.isfinite, (*read.start_position, *read.end_position))):
            return "a drag from or to a point that is not finite"
    return None
