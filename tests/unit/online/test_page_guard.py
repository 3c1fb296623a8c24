"""The page against others than its user: raw requests, raw messages, and who commands."""

import http.client
import math
import socket
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.sync.client import connect

from cablesense_msgs_py.messages import NO_CONTACT, Contact, ForceState, Level
from cablesense_online.page import guard
from cablesense_online.page.controls import Actions
from cablesense_online.page.guard import (
    MOST_CLIENTS,
    MOST_MESSAGE_BYTES,
    PageError,
    exposure_warning,
    free_port,
)
from cablesense_online.page.page import Page
from cablesense_online.page.shown_arm import ShownArm, joint_limit_deg
from cablesense_online.page.snapshot import ShownStatus, Snapshot
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import checked_command
from cablesense_sim.load_capacity import USUAL_CONTACT_N as FORCE_LIMIT_N
from cablesense_sim.touch import touched_places
from tests.helpers.page_visitor import SUBPROTOCOL, Visitor
from tests.helpers.waiting import until

pytestmark = pytest.mark.slow

ARM = open_arm("cdsm")
SHOWN = ShownArm(ARM)
LIMIT_DEG = joint_limit_deg(mechanism_of(ARM))
SLIDERS = ("force, N", "angle, °", "place, mm", "along, N", "joint 3 yaw, °")
FIRST_CONTACT = Contact(4, 215.0, 60.0, 0.065, 0.0)
FIRST_PUSH = ("push", FIRST_CONTACT, False)
NEAREST_M, FARTHEST_M = touched_places(ARM).touched_m[3]


SNAPSHOT = Snapshot(
    time_s=0.0,
    pose=np.zeros(8),
    frame_pose=np.zeros(8),
    readings=None,
    true=(),
    state=ForceState.SILENT,
    estimated=(),
    bounds=None,
    probabilities=None,
    status=ShownStatus(Level.STALE, "silent"),
)


@pytest.fixture(scope="module")
def served():
    """A page, and what it asked the nodes for, in order."""
    asked = []
    actions = Actions(
        lambda *push: asked.append(("push", *push)),
        lambda command_rad: asked.append(("command", *np.rad2deg(command_rad))),
        lambda: asked.append(("tare",)),
        lambda: asked.append(("undo",)),
        lambda: asked.append(("breathe",)),
        lambda: True,
        lambda: asked.append(("commission",)),
        lambda: True,
    )
    page = Page(SHOWN, actions, port=18_180)
    yield page, asked
    page.close()


@pytest.fixture
def page(served):
    yield served[0]
    until(lambda: not served[0]._server.get_clients(), "everyone to leave")
    until(lambda: served[0]._controls is None, "the arm to be let go")
    served[0]._kept_until_s = 0.0


@pytest.fixture
def asked(served):
    served[1].clear()
    return served[1]


@pytest.fixture
def visit(page):
    visitors = []

    def come(name=""):
        visitors.append(Visitor(page.url, name))
        return visitors[-1]

    yield come
    for visitor in reversed(visitors):
        visitor.close()


@pytest.fixture
def commander(visit):
    visitor = visit()
    until(lambda: "Tare" in visitor.read().controls, "the controls")
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


def refused_socket(page, status, path=None, **headers):
    """The page refuses a WebSocket."""
    url = urlsplit(page.url)
    with pytest.raises(InvalidStatus, match=str(status)):
        connect(
            f"ws://{headers.get('Host', url.netloc)}{url.path if path is None else path}",
            sock=socket.create_connection(("127.0.0.1", url.port)),
            origin=headers.get("Origin"),
            subprotocols=[SUBPROTOCOL],
        )


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Host": "evil.example:18180", "Origin": "http://evil.example:18180"},  # DNS rebinding
        {"Origin": "http://127.0.0.1:9999"},
        {"Origin": "null"},
    ],
)
def test_another_website_gets_neither_page_nor_websocket(page, headers):
    assert get(page, **headers)[0] == 403
    refused_socket(page, 403, **headers)


def test_a_websocket_needs_an_origin_and_the_token_and_so_does_the_page(page):
    refused_socket(page, 403)
    for path in ("/", "/index.html", "/" + "A" * 22 + "/", "/%00/", "//"):
        status, text = get(page, path)
        assert (status, "the whole address" in text) == (403, True)
        refused_socket(page, 403, path, Origin=f"http://{urlsplit(page.url).netloc}")
    other = Page(SHOWN, None, port=page.port)
    assert other.port > page.port
    assert urlsplit(other.url).path != urlsplit(page.url).path
    visitor = Visitor(other.url)
    until(lambda: other._server.get_clients(), "the visitor")
    nobody_commands = {"Home view", "Reset the errors"}
    assert set(visitor.read(0.3).controls) == nobody_commands
    visitor.close()
    other.close()


@pytest.mark.parametrize("host", ["127.0.0.1:18180", "localhost:18180", "[::1]:9000", "10.0.0.7"])
def test_the_user_gets_the_page_by_its_address_or_through_a_tunnel(page, host):
    status, text = get(page, Host=host)
    assert (status, "<html" in text) == (200, True)
    assert get(page, Host=host, Origin=f"http://{host}")[0] == 200


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch):
    stopped = []

    class Unguarded:
        def __init__(self, **_):
            pass

        def stop(self):
            stopped.append(self)

    monkeypatch.setattr(guard.viser, "ViserServer", Unguarded)
    with pytest.raises(PageError, match="any website could command the arm"):
        Page(SHOWN, None, port=18_190)
    assert stopped


def test_too_long_a_message_and_too_many_browsers_are_refused(page, visit, commander):
    for _ in range(MOST_CLIENTS - 1):
        visit()
    assert get(page)[0] == 503
    commander.send({"type": "GuiUpdateMessage", "uuid": "a" * MOST_MESSAGE_BYTES, "updates": {}})
    with pytest.raises(ConnectionClosedError) as closed:
        commander.read(10.0)
    assert closed.value.rcvd.code == 1009


@pytest.mark.parametrize(
    ("value", "contact", "joint_deg"),
    [
        (1e300, Contact(4, 355.0, FORCE_LIMIT_N, FARTHEST_M, 0.5 * FORCE_LIMIT_N), LIMIT_DEG),
        (-1e6, Contact(4, 0.0, 0.0, NEAREST_M, -0.5 * FORCE_LIMIT_N), -LIMIT_DEG),
        (7, Contact(4, 7.0, 7.0, 1e-3 * 7.0, 7.0), 7.0),
        (True, Contact(4, 1.0, 1.0, 1e-3, 1.0), 1.0),
    ],
)
def test_values_are_brought_into_range_whatever_a_browser_sends(
    asked, commander, value, contact, joint_deg
):
    commander.put("Push", True)
    until(lambda: asked, "the first push")
    for label in SLIDERS:
        commander.put(label, value)
    until(lambda: ("push", contact, False) in asked, "the push")
    until(lambda: [one for one in asked if one[0] == "command"], "the command")
    (command,) = (one for one in asked if one[0] == "command")
    np.testing.assert_allclose(command[1:], [0.0] * 5 + [joint_deg] + [0.0] * 2)
    pushes = np.array([one[1][:5] for one in asked if one[0] == "push"])
    least = 4, 0.0, 0.0, NEAREST_M, -0.5 * FORCE_LIMIT_N
    most = 4, 355.0, FORCE_LIMIT_N, FARTHEST_M, 0.5 * FORCE_LIMIT_N
    assert ((pushes >= least) & (pushes <= most)).all()


def test_a_browser_sends_values_of_controls_and_nothing_else(
    monkeypatch, page, asked, commander, caplog
):
    shared = []
    monkeypatch.setattr(page._server, "request_share_url", lambda: shared.append(True))
    commander.put("Push", True)
    until(lambda: asked, "the first push")
    for value in (np.nan, np.inf, "much", "nan", "", None, [1.0], {"a": 1}, b"1", "4" * 101):
        for label in (*SLIDERS, "segment"):
            commander.put(label, value)
    uuid = commander.controls["Tare"]
    for updates in ({"update_cb": []}, {"removed": True}, {"value": True, "removed": True}, 3):
        commander.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})
    commander.send({"type": "ShareUrlRequest"})
    of = {"transfer_uuid": "1", "source_component_uuid": commander.controls["force, N"]}
    upload = {"filename": "a", "mime_type": "", "part_count": 1, "size_bytes": 10_000}
    commander.send({"type": "FileTransferStartUpload", **of, **upload})
    commander.send({"type": "FileTransferPart", **of, "part_index": 0, "content": bytes(10_000)})
    commander.socket.send(b"\xc1")
    commander.socket.send("text")
    commander.put("Tare", True)
    until(lambda: ("tare",) in asked, "the tare")
    assert asked == [FIRST_PUSH, ("tare",)]
    (line,) = caplog.messages  # viser would log a traceback of each
    assert line == "the page drops a browser's value: nan is not finite"
    assert commander.read(0.3).acknowledged == 0
    assert not shared


def test_one_commands_and_the_next_takes_over_when_they_leave(asked, visit, commander):
    assert commander.reads("You command the arm</b>, nobody else watches")
    watcher = visit()
    until(lambda: watcher.reads("Another visitor commands the arm"), "who commands")
    until(lambda: commander.reads("one other watches"), "that somebody watches")
    assert "Push" not in watcher.controls
    commander.put("Home", True)
    until(lambda: asked, "the straight pose")
    asked.clear()
    watcher.controls.update(commander.controls)
    watcher.put("Tare", True)
    watcher.put("joint 2 yaw, °", 12.0)
    commander.put("joint 1 pitch, °", 5.0)
    commander.put("Push", True)
    until(lambda: len(asked) == 2, "what the first asked for")
    assert sorted(asked) == [("command", 5.0, *[0.0] * 7), FIRST_PUSH]
    watcher.controls.clear()
    asked.clear()
    commander.close()
    until(lambda: "Tare" in watcher.read().controls, "the controls")
    assert asked == [("push", NO_CONTACT, False)]
    assert watcher.reads("You command the arm</b>, nobody else watches")
    watcher.put("joint 2 yaw, °", 12.0)
    until(lambda: len(asked) == 2, "what the second asked for")
    np.testing.assert_allclose(asked[1][1:], [5.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.0, 0.0])


def test_who_commanded_commands_again_after_a_reload_and_not_for_long(
    page, asked, visit, monkeypatch
):
    first = visit("first")
    until(lambda: "Tare" in first.read().controls, "the controls")
    second = visit("second")
    until(lambda: second.reads("Another visitor commands the arm"), "who commands")
    first.put("Push", True)
    until(lambda: asked == [FIRST_PUSH], "the push")
    first.close()
    until(lambda: second.reads("Nobody commands the arm"), "that the first has left")
    assert asked == [FIRST_PUSH, ("push", NO_CONTACT, False)]
    returned = visit("first")
    until(lambda: "Tare" in returned.read().controls, "the controls again")
    assert returned.reads("You command the arm</b>, one other watches")
    until(lambda: second.reads("Another visitor commands the arm"), "who commands again")
    monkeypatch.setattr("cablesense_online.page.page._RETURN_S", 0.3)
    returned.close()
    until(lambda: second.reads("Nobody commands the arm"), "that the first has left for good")

    def taken_over():
        page.show(SNAPSHOT)
        return "Tare" in second.read().controls

    until(taken_over, "the controls for the next")
    assert second.reads("You command the arm</b>, nobody else watches")


@pytest.mark.parametrize("name", ["", "a/b", "..", "a" * 65, "%2e"])
def test_a_visitor_without_a_right_name_is_served_and_not_known_again(visit, name):
    first = visit(name)
    until(lambda: "Tare" in first.read().controls, "the controls")
    second = visit(name)
    until(lambda: second.reads("Another visitor commands the arm"), "who commands")
    first.close()
    until(lambda: "Tare" in second.read().controls, "the controls at once")


def click(segment, at_m, **changed):
    """On a segment of the straight arm, from beside it."""
    mechanism = mechanism_of(ARM)
    x_m = mechanism.joint_position_straight_m[segment - 1] + at_m
    return {
        "type": "SceneNodeClickMessage",
        "name": f"/arm/segment_{segment}/body",
        "instance_index": None,
        "ray_origin": (float(x_m), -2.0, 0.0),
        "ray_direction": (0.0, 1.0, 0.0),
        "screen_pos": (0.5, 0.5),
        "modifier": None,
        "owner": "",
        **changed,
    }


def test_a_click_on_the_arm_chooses_segment_and_place_for_the_one_who_commands(
    asked, visit, commander
):
    watcher = visit()
    until(lambda: watcher.reads("Another visitor commands the arm"), "who commands")
    commander.put("Push", True)
    until(lambda: asked == [FIRST_PUSH], "the first push")
    watcher.send(click(1, 0.05))
    for wrong in (
        {"ray_origin": (np.nan, 0.0, 0.0)},
        {"ray_direction": (0.0, 0.0, np.inf)},
        {"ray_direction": (1.0, 0.0, 0.0)},  # along the axis
        {"ray_origin": (1.0, 2.0)},
        {"name": "x" * 101},
        {"name": "/arm/segment_9/body"},
        {"modifier": "shift"},
    ):
        commander.send(click(2, 0.05, **wrong))
    commander.send(click(2, 0.1))
    until(lambda: len(asked) > 1, "the push there")
    commander.send(click(3, 5.0))
    until(lambda: len(asked) > 2, "the push beyond")
    there = FIRST_CONTACT._replace(segment=2, contact_m=0.1)
    end = FIRST_CONTACT._replace(segment=3, contact_m=FARTHEST_M)
    assert asked == [FIRST_PUSH, ("push", there, False), ("push", end, False)]


def test_the_home_view_shows_the_whole_arm_from_wherever_a_watcher_has_gone(visit, commander):
    watcher = visit()
    until(lambda: watcher.read().camera_m, "the first view")
    first_m = watcher.camera_m
    assert watcher.reset_camera_m == pytest.approx(first_m), "Reset View of the viewer's menu"
    watcher.look_from(30.0, 20.0, 10.0)
    assert watcher.read(0.3).camera_m is None, "a camera that moves is left alone"
    commander.read().camera_m = None
    watcher.put("Home view", True)
    until(lambda: watcher.read().camera_m, "the home view")
    assert watcher.camera_m == pytest.approx(first_m)
    assert commander.read(0.1).camera_m is None


def test_a_reset_on_a_phone_shows_the_whole_arm_too(commander):
    commander.look_from(1.0, 1.0, 1.0, image_width=390, image_height=844)
    until(lambda: commander.read().camera_m, "the view of another shape")
    on_phone_m = commander.camera_m
    commander.look_from(*commander.reset_camera_m, image_width=390, image_height=844)
    until(lambda: commander.read().camera_m, "the view after a reset")
    assert commander.camera_m == pytest.approx(on_phone_m)
    assert np.linalg.norm(on_phone_m) > 1.5 * np.linalg.norm(commander.reset_camera_m)


def drag(phase, pull_m=(0.0, 0.0, 0.0)):
    """Of segment 3 of the straight arm, 50 mm from its joint, by a vector."""
    held_m = np.array([mechanism_of(ARM).joint_position_straight_m[2] + 0.05, -0.017, 0.0])
    return {
        "type": "SceneNodeDragMessage",
        "phase": phase,
        "name": "/arm/segment_3/body",
        "instance_index": None,
        "start_position": tuple(held_m.tolist()),
        "start_screen_pos": (0.5, 0.5),
        "end_position": tuple((held_m + pull_m).tolist()),
        "end_screen_pos": (0.5, 0.5),
        "button": "left",
        "modifier": None,
        "owner": "",
    }


ARM_M = float(mechanism_of(ARM).joint_position_straight_m[-1]) + 0.13
PULL_M_PER_N = 0.75 * ARM_M / FORCE_LIMIT_N
"""The arrow of the strongest force is three quarters as long as the arm."""


def test_a_drag_on_the_arm_pulls_it_until_the_mouse_lets_go(asked, visit, commander):
    watcher = visit()
    until(lambda: watcher.reads("Another visitor commands the arm"), "who commands")
    for phase in ("start", "update", "end"):
        watcher.send(drag(phase, (0.0, 0.0, 0.1)))
    commander.send(drag("start"))
    commander.send(drag("update", (0.0, 30.0 * PULL_M_PER_N, 40.0 * PULL_M_PER_N)))
    until(lambda: len(asked) == 2, "the pull")
    for wrong in (
        {"start_position": (np.nan, 0.0, 0.0)},
        {"end_position": (0.0, np.inf, 0.0)},
        {"end_position": (0.0, 0.0, 1e9)},
        {"end_position": (0.0, 0.0)},
        {"button": "right"},
        {"modifier": "shift"},
        {"phase": "middle"},
        {"name": "/arm/segment_9/body"},
    ):
        commander.send(drag("update", (0.0, 0.0, 0.2)) | wrong)
    commander.send(drag("update", (-9.0, 0.0, 90.0)))
    commander.send(drag("end", (-9.0, 0.0, 90.0)))
    commander.send(drag("update", (0.0, 0.0, 0.2)))
    until(lambda: len(asked) >= 4, "the end")
    commander.put("Tare", True)
    until(lambda: asked[-1] == ("tare",), "that nothing came after the end")
    asked.pop()
    (_, first, beside), (_, pulled, _), (_, strongest, _), released = asked
    assert (first.segment, first.magnitude_n, beside) == (3, 0.0, False)
    expected = Contact(3, math.degrees(math.atan2(3.0, 4.0)), 50.0, 0.05)
    assert pulled[:5] == pytest.approx(expected[:5])
    assert strongest[:3] == pytest.approx((3, 0.0, FORCE_LIMIT_N))
    # friction carries no more along a segment
    assert strongest.along_n == pytest.approx(-touched_places(ARM).friction * FORCE_LIMIT_N)
    assert released == ("push", NO_CONTACT, False)


def test_after_a_drag_the_push_of_the_button_goes_on_with_what_was_dragged(asked, commander):
    commander.put("Push", True)
    until(lambda: asked == [FIRST_PUSH], "the first push")
    for phase in ("start", "update", "end"):
        commander.send(drag(phase, (0.0, 0.0, -50.0 * PULL_M_PER_N)))
    until(lambda: len(asked) == 4, "the end")
    (_, last, beside) = asked[-1]
    assert last[:5] == pytest.approx((3, 180.0, 50.0, 0.05, 0.0))
    assert not beside
    commander.put("Push", True)
    until(lambda: len(asked) == 5, "the release")
    assert asked[-1] == ("push", NO_CONTACT, False)


def test_who_leaves_in_a_drag_lets_go(asked, commander):
    commander.send(drag("start"))
    commander.send(drag("update", (0.0, 0.0, 0.05)))
    until(lambda: len(asked) == 2, "the pull")
    commander.close()
    until(lambda: asked[-1] == ("push", NO_CONTACT, False), "the release")


@pytest.mark.parametrize("offset_m", [0.002, 0.010, 0.015, 0.060])
def test_sliders_keep_within_what_the_guide_plates_allow(offset_m):
    mechanism = replace(mechanism_of(ARM), plate_offset_m=offset_m)
    limit_deg = joint_limit_deg(mechanism)
    assert 0.0 < limit_deg <= 20.0
    checked_command(mechanism, np.deg2rad(np.full(8, limit_deg)))


def test_a_host_that_is_not_of_this_machine_has_a_remedy():
    with pytest.raises(PageError, match="another --host or --port"):
        free_port("203.0.113.7", 8080)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.0.1", "localhost", "::1"])
def test_loopback_is_no_exposure(host):
    assert exposure_warning(host, 8080, controls=True) == ""


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "::", "robot", "", "127.0.0.1.x"])
def test_any_other_host_is_one_line_of_warning(host):
    line = exposure_warning(host, 8080, controls=True)
    assert line.endswith("given its address, or listens in on the way, can see and move the arm")
    assert len(line.splitlines()) == 1
    assert "move" not in exposure_warning(host, 8080, controls=False)
