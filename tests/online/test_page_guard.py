"""The page against others than its user: raw requests, raw messages, and who commands."""

import http.client
import socket
import time
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
from page_visitor import SUBPROTOCOL, Visitor
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from cablesense_online.page import guard
from cablesense_online.page.guard import MOST_CLIENTS, MOST_MESSAGE_BYTES, PageError
from cablesense_online.page.page import Page
from cablesense_online.page.panel import Actions, joint_limit_deg
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.load_capacity import USUAL_CONTACT_N as FORCE_LIMIT_N

pytestmark = pytest.mark.slow


ARM = open_arm("cdsm")


def eventually(condition, what):
    until = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < until, f"waited in vain for {what}"
        time.sleep(0.01)


class Asked(list):
    """What the page asked the nodes for, in order."""

    @property
    def actions(self):
        return Actions(
            lambda *push: self.append(("push", *push)),
            lambda command_rad: self.append(("command", *np.rad2deg(command_rad))),
            lambda: self.append(("tare",)),
            lambda: self.append(("undo",)),
            lambda: self.append(("breathe",)),
        )


@pytest.fixture(scope="module")
def served():
    asked = Asked()
    page = Page(ARM, asked.actions, port=18_180)
    yield page, asked
    page.close()


@pytest.fixture
def page(served):
    yield served[0]
    eventually(lambda: not served[0]._server.get_clients(), "everyone to leave")
    eventually(lambda: served[0]._controls is None, "the arm to be let go")


@pytest.fixture
def asked(served):
    served[1].clear()
    return served[1]


@pytest.fixture
def visit(page):
    visitors = []

    def come():
        visitors.append(Visitor(page.url))
        return visitors[-1]

    yield come
    for visitor in reversed(visitors):
        visitor.close()


@pytest.fixture
def commander(visit):
    visitor = visit()
    eventually(lambda: "Tare" in visitor.read().controls, "the controls")
    return visitor


def get(page, path=None, **headers):
    """Status and text that the page answers a GET with, by default of its own address."""
    url = urlsplit(page.url)
    connection = http.client.HTTPConnection("127.0.0.1", url.port, timeout=10.0)
    connection.putrequest("GET", url.path if path is None else path, skip_host=True)
    for name, value in {"Host": url.netloc, **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


FOREIGN = {"Origin": "http://evil.example"}
REBOUND = {"Host": "evil.example:18180", "Origin": "http://evil.example:18180"}
NEIGHBOUR = {"Origin": "http://127.0.0.1:9999"}


@pytest.mark.parametrize("headers", [FOREIGN, REBOUND, NEIGHBOUR, {"Origin": "null"}])
def test_another_website_gets_neither_page_nor_websocket(page, headers):
    url = urlsplit(page.url)
    assert get(page, **headers)[0] == 403
    netloc = headers.get("Host", url.netloc)
    with pytest.raises(InvalidStatus, match="403"):
        connect(
            f"ws://{netloc}{url.path}",
            sock=socket.create_connection(("127.0.0.1", url.port)),
            origin=headers["Origin"],
            subprotocols=[SUBPROTOCOL],
        )


def test_a_websocket_without_an_origin_is_refused(page):
    with pytest.raises(InvalidStatus, match="403"):
        connect(page.url.replace("http", "ws"), subprotocols=[SUBPROTOCOL])


@pytest.mark.parametrize("path", ["/", "/index.html", "/" + "A" * 22 + "/", "/%00/", "//"])
def test_without_the_token_nothing_is_served(page, path):
    status, text = get(page, path)
    assert status == 403
    assert "the whole address" in text
    url = urlsplit(page.url)
    with pytest.raises(InvalidStatus, match="403"):
        connect(
            f"ws://{url.netloc}{path}",
            origin=f"http://{url.netloc}",
            subprotocols=[SUBPROTOCOL],
        )


@pytest.mark.parametrize("host", ["127.0.0.1:18180", "localhost:18180", "[::1]:9000", "10.0.0.7"])
def test_the_user_gets_the_page_by_its_address_or_through_a_tunnel(page, host):
    status, text = get(page, Host=host)
    assert status == 200
    assert "<html" in text
    assert get(page, Host=host, Origin=f"http://{host}")[0] == 200


def test_every_page_has_a_token_of_its_own(page):
    other = Page(ARM, None, port=page.port + 1)
    assert len(urlsplit(other.url).path) == 24
    assert urlsplit(other.url).path != urlsplit(page.url).path
    other.close()


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch):
    stopped = []

    class Unguarded:
        def __init__(self, **_):
            pass

        def stop(self):
            stopped.append(self)

    monkeypatch.setattr(guard.viser, "ViserServer", Unguarded)
    with pytest.raises(PageError, match="any website could command the arm"):
        Page(ARM, None, port=18_190)
    assert stopped


def test_a_message_beyond_the_limit_ends_the_connection(commander):
    commander.send({"type": "GuiUpdateMessage", "uuid": "a" * MOST_MESSAGE_BYTES, "updates": {}})
    with pytest.raises(ConnectionClosedError) as closed:
        commander.read(10.0)
    assert closed.value.rcvd.code == 1009


def test_more_browsers_than_the_limit_are_refused(page, visit):
    for _ in range(MOST_CLIENTS):
        visit()
    with pytest.raises(InvalidStatus, match="503"):
        visit()
    assert get(page)[0] == 503


def test_nothing_is_uploaded_and_the_page_is_not_shared(monkeypatch, page, asked, commander):
    shared = []
    monkeypatch.setattr(page._server, "request_share_url", lambda: shared.append(True))
    commander.send({"type": "ShareUrlRequest"})
    slider = {"transfer_uuid": "1", "source_component_uuid": commander.controls["force, N"]}
    upload = {"filename": "a", "mime_type": "", "part_count": 3, "size_bytes": 30_000}
    commander.send({"type": "FileTransferStartUpload", **slider, **upload})
    for part in range(3):
        content = {"part_index": part, "content": bytes(10_000)}
        commander.send({"type": "FileTransferPart", **slider, **content})
    commander.put("Tare", True)
    eventually(lambda: asked, "the tare")
    assert commander.read(0.3).acknowledged == 0
    assert not shared


LIMIT_DEG = joint_limit_deg(mechanism_of(ARM))


@pytest.mark.parametrize(
    ("value", "force_n", "angle_deg", "joint_deg"),
    [
        (1e6, FORCE_LIMIT_N, 355.0, LIMIT_DEG),
        (-1e6, 0.0, 0.0, -LIMIT_DEG),
        (1e300, FORCE_LIMIT_N, 355.0, LIMIT_DEG),
        (7, 7.0, 7.0, 7.0),
        (True, 1.0, 1.0, 1.0),
    ],
)
def test_values_are_brought_into_range_whatever_a_browser_sends(
    asked, commander, value, force_n, angle_deg, joint_deg
):
    commander.put("Push", True)
    eventually(lambda: asked, "the first push")
    for label in ("force, N", "angle, °", "joint 3 yaw, °"):
        commander.put(label, value)
    eventually(lambda: ("push", 4, angle_deg, force_n, False) in asked, "the push")
    eventually(lambda: [one for one in asked if one[0] == "command"], "the command")
    (command,) = (one for one in asked if one[0] == "command")
    np.testing.assert_allclose(command[1:], [0.0] * 5 + [joint_deg] + [0.0] * 2)
    pushes = np.array([one[2:4] for one in asked if one[0] == "push"])
    assert ((pushes >= 0.0) & (pushes <= [355.0, FORCE_LIMIT_N])).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, "much", "", None, [1.0], {"a": 1}, b"1"])
def test_what_is_no_number_does_nothing(asked, commander, value):
    commander.put("Push", True)
    eventually(lambda: asked, "the first push")
    for label in ("force, N", "angle, °", "joint 3 yaw, °", "segment"):
        commander.put(label, value)
    commander.read(0.2)
    commander.put("Tare", True)
    eventually(lambda: ("tare",) in asked, "the tare")
    assert asked == [("push", 4, 215.0, 60.0, False), ("tare",)]


def test_a_browser_changes_values_and_nothing_else_of_a_control(asked, commander):
    uuid = commander.controls["Tare"]
    for updates in ({"update_cb": []}, {"removed": True}, {"value": True, "removed": True}, 3):
        commander.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})
    commander.socket.send(b"\xc1")
    commander.socket.send("text")
    commander.put("Tare", True)
    eventually(lambda: asked == [("tare",)], "one tare")


def test_one_commands_and_the_next_takes_over_when_they_leave(asked, visit, commander):
    assert commander.reads("You command the arm</b>, nobody else watches")
    watcher = visit()
    eventually(lambda: watcher.reads("commands the arm</b>; you are visitor"), "who commands")
    eventually(lambda: commander.reads("one other watches"), "that somebody watches")
    assert "Push" not in watcher.controls
    commander.put("Home", True)
    eventually(lambda: asked, "the straight pose")
    asked.clear()
    watcher.controls.update(commander.controls)
    watcher.put("Tare", True)
    watcher.put("joint 2 yaw, °", 12.0)
    commander.put("joint 1 pitch, °", 5.0)
    commander.put("Push", True)
    eventually(lambda: len(asked) == 2, "what the first asked for")
    assert sorted(asked) == [("command", 5.0, *[0.0] * 7), ("push", 4, 215.0, 60.0, False)]
    watcher.controls.clear()
    asked.clear()
    commander.close()
    eventually(lambda: "Tare" in watcher.read().controls, "the controls")
    assert asked == [("push", 1, 0.0, 0.0, False)]
    assert watcher.reads("You command the arm</b>, nobody else watches")
    watcher.put("joint 2 yaw, °", 12.0)
    eventually(lambda: len(asked) == 2, "what the second asked for")
    np.testing.assert_allclose(asked[1][1:], [5.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.0, 0.0])


def test_a_page_without_controls_has_nobody_who_commands():
    page = Page(ARM, None, port=18_200)
    visitor = Visitor(page.url)
    eventually(lambda: page._server.get_clients(), "the visitor")
    assert set(visitor.read(0.3).controls) == {"Reset the errors"}
    visitor.close()
    page.close()


@pytest.mark.parametrize("offset_m", [0.002, 0.010, 0.015, 0.060])
def test_sliders_keep_within_what_the_guide_plates_allow(offset_m):
    mechanism = replace(mechanism_of(ARM), plate_offset_m=offset_m)
    limit_deg = joint_limit_deg(mechanism)
    assert 0.0 < limit_deg <= 20.0
    checked_command(mechanism, np.deg2rad(np.full(8, limit_deg)))
