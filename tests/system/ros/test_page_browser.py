"""The page in a real Chromium, over real DDS: it draws, and a push on it moves the estimate.

Another website gets nothing.
"""

import io
import signal
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: install the extra `page`")

from PIL import Image

from cablesense_ros.processes import ProcessError, Processes, node_command, own_graph
from tests.helpers.browser import (
    CUT_OFF,
    HEIGHT,
    PATIENCE_S,
    SCENE_RECT,
    SLIDER_VALUE,
    STATUS,
    WIDTH,
    WITHOUT_NOTICES,
    Browser,
    arrow_px,
    canvas_pixels,
    cells,
    chromium,
    drawn,
    eventually,
    is_orange,
    wait_for_cells,
)
from tests.helpers.page_visitor import SUBPROTOCOL

# a picture takes Chromium fifteen seconds where other tests keep the cores busy
pytestmark = [pytest.mark.browser, pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(500)]


@pytest.fixture(scope="module")
def browser_program():
    return chromium()


@pytest.fixture(scope="module")
def processes(tmp_path_factory, browser_program):
    environment = own_graph()
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    page = node_command("page", {"port": 18_080, "home_at_start": True, "rate_hz": 5.0})
    commands = {
        "sim": node_command("sim", {"rate_hz": 25.0}),
        "estimator": node_command("estimator"),
        "page": page,
    }
    with Processes(commands, tmp_path_factory.mktemp("logs"), environment) as processes:
        yield processes
        try:
            processes.check()
        except ProcessError as ended:
            ended.add_note(processes["page"].log)
            raise


@pytest.fixture(autouse=True)
def page_log(processes):
    """The page's log, which pytest shows with a test that fails."""
    yield
    print(processes["page"].log)


@pytest.fixture(scope="module")
def page_url(processes):
    return processes.wait_for_line("page", "page: ", PATIENCE_S)


@pytest.fixture
def website():
    """The address of another server of this machine, with an empty page."""

    class Empty(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Empty) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def browser(page_url, browser_program, tmp_path_factory):
    browser = Browser(browser_program, tmp_path_factory.mktemp("profile"))
    try:
        browser.call("Page.navigate", url=page_url)
        browser.wait_for("!!document.querySelector('#cablesense-status')", "its figures")
        browser.evaluate(WITHOUT_NOTICES)
        yield browser
    finally:
        browser.close()


@pytest.fixture
def at_rest(browser):
    """Nothing touches the arm, whatever the test before left on it."""
    browser.wait_for("document.body.innerText.includes('Move the joints')", "the controls")
    if browser.has_button("Release"):
        browser.click_button("Release")
    browser.wait_for(f"{STATUS} === 'No contact'", "an arm at rest")


def right(row):
    """Whether the cells of a contact are those of the page's first push, within its accuracy."""
    if row[:1] != ["4"]:
        return False
    place_mm, angle_deg, force_n = (float(cell) for cell in row[1:4])
    return (
        abs(place_mm - 65.0) < 1.0 and abs(angle_deg - 215.0) < 2.0 and abs(force_n - 60.0) < 2.0
    )


OPENED = """new Promise(done => {
    const socket = new WebSocket(%r, [%r]);
    socket.onopen = () => done("open");
    socket.onerror = () => done("refused");
})"""
"""Whether a page gets a WebSocket of this address."""


def test_another_website_gets_no_websocket_of_the_page(page_url, browser, website):
    """First, so that the start of the browser is not part of a longer test."""
    address = page_url.replace("http", "ws").rstrip("/")
    assert browser.evaluate(OPENED % (address, SUBPROTOCOL)) == "open"
    tab = browser.new_tab(website)
    for path in (address, address.rpartition("/")[0]):
        assert tab.evaluate(OPENED % (path, SUBPROTOCOL)) == "refused"
    tab.close()


def test_a_push_on_the_page_moves_arm_wrench_and_estimate(page_url, browser, at_rest):
    assert page_url.startswith("http://127.0.0.1:")
    text = browser.evaluate("document.body.innerText")
    for label in (
        "Push the arm",
        "place, mm",
        "angle, °",
        "force, N",
        "along, N",
        "joint 4 yaw, °",
        "Undo the tare",
        "contact probability",
        "cable tension",
        "direction error",
        "place error",
        "95 % of the place",
        "95 % of the force",
    ):
        assert label in text
    assert browser.evaluate("document.title") == "CableSense"
    assert "Breathe" not in text  # nothing here breathes
    font = browser.evaluate("getComputedStyle(document.querySelector('.cablesense')).fontSize")
    assert font == "13px"
    browser.wait_for("document.querySelectorAll('canvas').length >= 2", "the scene and the traces")
    before = eventually(lambda: canvas_pixels(browser), drawn, "the canvas stayed empty")
    browser.click_button("Push")
    true = wait_for_cells(browser, "true", lambda row: row[3:4] == ["60.0"])
    assert true == ["4", "65", "215.0", "60.0", "–"]
    wait_for_cells(browser, "estimated", right)

    def shows_both(after):
        blue = (after[..., 2] > 150) & (after[..., 0] < 90)
        changed = np.abs(after - before).max(axis=-1) > 40
        return is_orange(after).sum() > 50 and blue.sum() > 50 and changed.sum() > 500

    eventually(lambda: canvas_pixels(browser), shows_both, "the arrows were not drawn")
    browser.click_button("Release")
    wait_for_cells(browser, "true", lambda row: row[:1] == ["none"])
    wait_for_cells(browser, "estimated", lambda row: row[:1] == ["none"])


def test_a_push_off_the_middle_is_set_by_the_slider_and_drawn_there(browser, at_rest):
    browser.press("place, mm", "Home")
    browser.click_button("Push")
    wait_for_cells(browser, "true", lambda row: row[1:2] == ["0"])
    near_px = eventually(lambda: arrow_px(browser), np.isfinite, "no arrow was drawn")
    browser.press("place, mm", "End")
    true = wait_for_cells(browser, "true", lambda row: row[1:2] == ["130"])
    assert true[:4] == ["4", "130", "215.0", "60.0"]
    moved = "the arrow did not move along the arm"
    eventually(lambda: arrow_px(browser), lambda px: px > near_px + 20.0, moved)
    browser.press("along, N", "ArrowLeft")
    wait_for_cells(browser, "true", lambda row: row[4:] not in ([], ["–"], true[4:]))
    wait_for_cells(browser, "estimated", lambda row: row[:1] == ["4"])
    assert not browser.evaluate(CUT_OFF)
    browser.click_button("Release")
    wait_for_cells(browser, "true", lambda row: row[:1] == ["none"])


def test_floor_and_axes_can_be_seen(browser, at_rest):
    browser.resize(1280, 800)
    try:

        def below_the_arm():
            """Pixels (H, W, 3) between the panels."""
            image = np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"))
            return image[500:790, 400:1000].astype(int)

        def axes_px():
            """How many pixels are red, green and blue."""
            pixels = below_the_arm()
            others = np.stack([np.delete(pixels, n, axis=-1).max(axis=-1) for n in range(3)], -1)
            return (pixels > others + 60).sum(axis=(0, 1))

        eventually(axes_px, lambda count: (count > 20).all(), "an axis cannot be seen")
        grey = below_the_arm().mean(axis=-1)
        assert np.percentile(grey, 98) - np.median(grey) > 25.0, "lines of the floor"
    finally:
        browser.resize(WIDTH, HEIGHT)


def test_the_keys_of_a_slider_move_no_camera_and_the_home_view_leads_back(browser, at_rest):
    left, _, width, _ = map(round, browser.evaluate(SCENE_RECT))

    def scene():
        """Pixels (H, W, 3) between the panels."""
        image = np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"))
        return image[:, left + 10 : left + width - 10].astype(int)

    still = scene()

    def moved():
        """Share of the picture that has changed."""
        return (np.abs(scene() - still).max(axis=-1) > 40).mean()

    def stands_still():
        """Whether arrows of a push before are gone, and the view of another window."""
        nonlocal still
        still = scene()
        browser.wait_for_pictures()
        return drawn(still) and moved() < 0.001

    eventually(stands_still, bool, "the picture does not come to rest")
    set_at = browser.evaluate(SLIDER_VALUE)
    for _ in range(3):
        browser.press("angle, °", "ArrowLeft", pictures=2)
    eventually(
        lambda: browser.evaluate(SLIDER_VALUE), lambda at: at != set_at, "the slider stayed"
    )
    browser.wait_for_pictures()
    assert moved() < 0.01
    browser.evaluate("document.activeElement.blur()")

    def moved_after_a_key():
        """Share that has changed."""
        browser.hold("ArrowLeft", pictures=2)
        browser.wait_for_pictures()
        return moved()

    eventually(moved_after_a_key, lambda share: share > 0.05, "the camera's own keys")
    browser.click_button("Home view")
    eventually(moved, lambda share: share < 0.01, "the view is not that of the beginning")


def test_the_mouse_drags_a_force_on_the_arm(browser, at_rest):
    browser.resize(1280, 800)
    try:
        browser.click_button("Home view")
        browser.wait_for_pictures(4)  # by way of the node
        left, top, width, height = browser.evaluate(SCENE_RECT)
        # the home view looks at a point of segment 3, a little below its axis
        x = left + 0.5 * width
        y = top + 0.482 * height
        browser.mouse("mouseMoved", x, y, held=False)
        browser.mouse("mousePressed", x, y)
        for up_px in range(5, 85, 5):
            browser.mouse("mouseMoved", x, y - up_px)
        pulled = wait_for_cells(browser, "true", lambda row: row[:1] == ["3"] and row[3] != "0.0")
        _, place_mm, angle_deg, force_n, _ = pulled
        assert 20.0 < float(place_mm) < 60.0
        assert 5.0 < float(angle_deg) < 45.0, "up in the picture is up, and away from the eye"
        assert 5.0 < float(force_n) < 100.0
        wait_for_cells(browser, "estimated", lambda row: row[:1] == ["3"])
        browser.mouse("mouseReleased", x, y - 80)
        wait_for_cells(browser, "true", lambda row: row[:1] == ["none"])
        assert not browser.has_button("Release")
    finally:
        browser.resize(WIDTH, HEIGHT)


def test_a_silent_estimator_is_never_no_contact(processes, browser, at_rest):
    processes["estimator"].signal(signal.SIGSTOP)
    try:
        browser.wait_for(f"{STATUS} === 'The estimator is silent'", "the silence")
        assert cells(browser, "estimated")[0] == "no answer"
    finally:
        processes["estimator"].signal(signal.SIGCONT)
    browser.wait_for(f"{STATUS} === 'No contact'", "an estimate again")


def test_a_tab_is_the_same_visitor_after_a_reload_and_another_tab_is_not(
    page_url, browser, at_rest
):
    first = browser.evaluate("location.search")
    assert first.startswith(f"?websocket={page_url.replace('http', 'ws')}")
    browser.call("Page.reload")
    browser.wait_for("document.body.innerText.includes('You command the arm')", "the controls")
    browser.evaluate(WITHOUT_NOTICES)
    assert browser.evaluate("location.search") == first
    tab = browser.new_tab(page_url)
    tab.wait_for("location.search.includes('websocket')", "its visitor")
    assert tab.evaluate("location.search") != first
    tab.close()


def test_on_a_phone_the_estimate_is_there_and_nothing_is_cut_off(browser, at_rest):
    browser.click_button("Push")
    wait_for_cells(browser, "estimated", lambda row: row[:1] in (["3"], ["4"]))
    browser.resize(390, 844)
    try:
        summary = "document.querySelector('.cablesense-narrow')?.getBoundingClientRect()"
        browser.wait_for(f"{summary}.width > 300", "the estimate over the width of the phone")
        places = browser.evaluate(
            "[...document.querySelectorAll('.cablesense, .cablesense *, button')]"
            ".map(e => e.getBoundingClientRect()).filter(r => r.width > 0)"
            ".map(r => [r.left, r.right])"
        )
        assert min(left for left, _ in places) >= 0
        assert max(right for _, right in places) <= 390
        assert 0 < browser.evaluate(f"{summary}.bottom") <= 844
    finally:
        browser.resize(WIDTH, HEIGHT)
