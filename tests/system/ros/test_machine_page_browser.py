"""The page of a machine that MuJoCo describes in a real Chromium, over real DDS."""

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs viser: install the extra `page`")

from cablesense_ros.processes import Processes, node_command, own_graph
from tests.helpers.browser import (
    CUT_OFF,
    PATIENCE_S,
    WITHOUT_NOTICES,
    Browser,
    arrow_px,
    canvas_pixels,
    chromium,
    drawn,
    eventually,
    wait_for_cells,
)
from tests.helpers.example_machines import MACHINES

# a picture takes Chromium fifteen seconds where other tests keep the cores busy
pytestmark = [pytest.mark.browser, pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(500)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A browser with the page of the finger, which nobody estimates."""
    program = chromium()
    arm = {"arm": str(MACHINES / "finger.yaml")}
    commands = {
        "sim": node_command("sim", {"rate_hz": 20.0} | arm),
        "page": node_command("page", {"port": 18_090, "rate_hz": 5.0} | arm),
    }
    with Processes(commands, tmp_path_factory.mktemp("logs"), own_graph()) as processes:
        url = processes.wait_for_line("page", "page: ", PATIENCE_S)
        browser = Browser(program, tmp_path_factory.mktemp("profile"))
        try:
            browser.call("Page.navigate", url=url)
            browser.wait_for("document.body.innerText.includes('Move the joints')", "the controls")
            browser.evaluate(WITHOUT_NOTICES)
            yield browser
        finally:
            browser.close()


def test_a_machine_is_shown_under_its_own_names(browser):
    text = browser.evaluate("document.body.innerText")
    for label in (
        "Push the machine",
        "Waiting for the estimator",
        "fingertip",
        "flexor_deep",
        "curl, °",
        "tension now, N, by the body that a tendon ends on",
    ):
        assert label in text
    for absent in ("segment", "joint 1", "Commission", "Breathe"):
        assert absent not in text
    assert not browser.evaluate(CUT_OFF)


def test_a_machine_is_drawn_pushed_and_moved(browser):
    eventually(lambda: canvas_pixels(browser), drawn, "the canvas stayed empty")
    browser.click_button("Push")
    true = wait_for_cells(browser, "true", lambda row: row[:1] == ["fingertip"])
    assert true == ["fingertip", "4", "215.0", "1.50", "–"]
    at_home = eventually(lambda: arrow_px(browser), np.isfinite, "no arrow was drawn")

    def arrow_px_of_a_curled_finger():
        """Its column; a page that draws for long may miss a key."""
        browser.press("curl, °", "End")
        return arrow_px(browser)

    curled = "the arrow did not follow the fingertip"
    eventually(arrow_px_of_a_curled_finger, lambda px: abs(px - at_home) > 5.0, curled)
