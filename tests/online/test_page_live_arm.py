"""The state that the page shows, and its port."""

import socket
from types import SimpleNamespace as Message

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_msgs_py.messages import ForceState, Level
from cablesense_online.page.live_arm import STALE_S, ForceBounds, LiveArm
from cablesense_online.page.page import PageError, free_port
from cablesense_sim.arm import open_arm
from cablesense_sim.kinematics import contact_points_m

ARM = open_arm("cdsm")


@pytest.fixture
def live():
    return LiveArm(ARM, joint_speed_rad_s=1.0)


def wrench(frame, force=(0.0, 0.0, 0.0)):
    x, y, z = (float(component) for component in force)
    zero = Message(x=0.0, y=0.0, z=0.0)
    return Message(
        header=Message(frame_id=frame),
        wrench=Message(force=Message(x=x, y=y, z=z), torque=zero),
    )


def tensions():
    return Message(name=list(ARM.cable_names), effort=[50.0] * 12)


def receive(live, state, now_s):
    """Tensions and a `status` message arrive."""
    header = Message(stamp=Message(sec=1, nanosec=0))
    live.on_tensions(tensions(), now_s)
    live.on_status(Message(header=header, status=[Message(message=state.value)]), now_s)


def diagnosed(part, level, text):
    """A `/diagnostics` message of the estimator."""
    name = f"estimator: {part}"
    return Message(status=[Message(name=name, level=bytes([level]), message=text)])


def test_a_push_makes_the_true_contact_that_was_asked_for(live):
    for load in live.loads_of(3, 120.0, 40.0):
        live.on_load(wrench(f"segment_{load.segment}", load.force_base_n))
    true = live.snapshot(0.0).true
    assert (true.segment, true.magnitude_n) == (3, pytest.approx(40.0))
    assert true.angle_deg == pytest.approx(120.0)


def test_a_load_about_the_base_is_that_of_its_segment(live):
    live.on_load(wrench("segment_3", (0.0, 0.0, 20.0)))
    usual = live.snapshot(0.0).true
    live.on_load(wrench("segment_3"))
    message = wrench("base_link", (0.0, 0.0, 20.0))
    torque = np.cross(contact_points_m(live.mechanism, np.zeros(8))[2], [0.0, 0.0, 20.0])
    message.wrench.torque = Message(x=torque[0], y=torque[1], z=torque[2])
    live.on_load(message)
    assert live.snapshot(0.0).true.segment == usual.segment == 3
    assert live.snapshot(0.0).true.magnitude_n == pytest.approx(usual.magnitude_n)


def test_contacts_of_several_segments_are_shown_and_old_ones_are_not(live):
    receive(live, ForceState.CONTACT, 1.0)
    live.on_wrench(wrench("segment_4", (0.0, 0.0, 30.0)), 1.0)
    live.on_segment_wrench(wrench("segment_1", (0.0, 9.0, 0.0)), 1.0 - 2 * STALE_S)
    live.on_segment_wrench(wrench("segment_2", (0.0, 10.0, 0.0)), 1.0)
    live.on_segment_wrench(wrench("segment_3"), 1.0)
    live.on_segment_wrench(wrench("segment_4", (0.0, 0.0, 30.0)), 1.0)
    shown = live.snapshot(1.0)
    assert [each.segment for each in shown.all_estimated] == [4, 2]
    assert shown.estimate.magnitude_n == pytest.approx(30.0)
    assert shown.status.headline == "Contact on segments 2 and 4"


def test_a_push_releases_the_previous_one_unless_both_are_wanted(live):
    live.on_load(wrench("segment_2", (0.0, 0.0, 10.0)))
    released, pushed = live.loads_of(4, 0.0, 15.0)
    assert (released.segment, pushed.segment) == (2, 4)
    assert not released.force_base_n.any()
    (pushed,) = live.loads_of(4, 0.0, 15.0, beside=True)
    live.on_load(wrench("segment_4", pushed.force_base_n))
    assert [each.segment for each in live.snapshot(0.0).all_true] == [4, 2]


def command(first_rad):
    names, others = list(ARM.joint_names), [0.0] * 7
    return Message(header=Message(frame_id=""), name=names, position=[first_rad, *others])


def test_an_estimate_is_turned_into_base_axes_at_the_commanded_pose(live):
    live.on_joint_commands(command(np.pi / 6))
    for now_s in (0.0, 30.0):
        live.snapshot(now_s)
    receive(live, ForceState.CONTACT, 30.0)
    live.on_wrench(wrench("segment_1", (0.0, 0.0, 10.0)), 30.0)
    estimate = live.snapshot(30.0).estimate
    assert estimate.angle_deg == pytest.approx(0.0)
    expected = [10.0 * np.sin(np.pi / 6), 0.0, 10.0 * np.cos(np.pi / 6)]
    np.testing.assert_allclose(estimate.force_base_n, expected, atol=1e-9)


def test_old_estimates_and_old_tensions_are_not_shown_as_the_present(live):
    assert live.snapshot(0.0).status.level is Level.STALE
    receive(live, ForceState.CONTACT, 1.0)
    live.on_wrench(wrench("segment_1", (0.0, 5.0, 0.0)), 1.0)
    assert live.snapshot(1.1).status.headline == "Contact on segment 1"
    live.on_tensions(tensions(), 2.0)
    later = live.snapshot(1.0 + 2 * STALE_S)
    assert later.estimate is None
    assert later.state is ForceState.SILENT
    assert later.status.level is Level.STALE
    assert "silent" in later.status.headline


@pytest.mark.parametrize("state", [each for each in ForceState if not each.known])
def test_what_is_not_known_is_never_shown_as_no_contact(live, state):
    receive(live, state, 1.0)
    live.on_wrench(wrench("base_link"), 1.0)
    shown = live.snapshot(1.0)
    assert shown.status.headline != "No contact"
    assert shown.status.level is not Level.OK
    assert shown.probabilities is None


def test_the_stated_interval_is_that_between_two_wrenches(live):
    receive(live, ForceState.HIDDEN, 1.0)
    assert live.snapshot(1.0).bounds is None
    live.on_lower(wrench("base_link"), 1.0)
    live.on_upper(wrench("segment_2", (0.0, 3.0, -4.0)), 1.0)
    shown = live.snapshot(1.0)
    assert shown.bounds == ForceBounds(0.0, 5.0)  # of any direction
    live.on_lower(wrench("segment_3", (0.0, 3.0, 3.0)), 1.0)
    live.on_upper(wrench("segment_3", (0.0, 4.0, 0.0)), 1.0)
    bounds = live.snapshot(1.0).bounds
    assert bounds.angles_deg == pytest.approx((45.0, 90.0))
    assert bounds.high_n == pytest.approx(4.0)
    assert "up to 5.0 N" in shown.status.headline


@pytest.mark.parametrize(
    ("part", "level", "shown"),
    [
        ("cables", Level.WARN, Level.OK),
        ("cable_tensions", Level.WARN, Level.OK),
        ("cable_tensions", Level.ERROR, Level.ERROR),
        ("tare", Level.WARN, Level.WARN),
        ("plausibility", Level.ERROR, Level.ERROR),
    ],
)
def test_a_warning_that_lessens_no_trust_is_a_note_alone(live, part, level, shown):
    receive(live, ForceState.FREE, 1.0)
    live.on_diagnostics(diagnosed(part, level, "as it is"), 1.0)
    status = live.snapshot(1.0).status
    assert (status.level, status.notes) == (shown, ("as it is",))


def test_of_a_load_along_the_segment_nothing_can_be_felt(live):
    live.on_load(wrench("segment_2", (50.0, 3.0, 4.0)))
    true = live.snapshot(0.0).true
    assert (true.segment, true.magnitude_n) == (2, pytest.approx(5.0))
    live.on_load(wrench("segment_2", (50.0, 0.0, 0.0)))
    assert live.snapshot(0.0).true is None


@pytest.mark.parametrize("frame", ["segment_5", "segment_0", "world", ""])
def test_a_load_in_an_unknown_frame_is_refused(live, frame):
    with pytest.raises(CableSenseError, match="frame_id"):
        live.on_load(wrench(frame, (0.0, 0.0, 1.0)))
    assert live.snapshot(0.0).true is None


def test_a_command_that_the_arm_refuses_is_not_shown(live):
    with pytest.raises(CableSenseError, match="plates touch"):
        live.on_joint_commands(command(0.6))
    for now_s in (0.0, 30.0):
        assert not live.snapshot(now_s).joint_angles_rad.any()


@pytest.mark.parametrize("force", [float("nan"), float("inf"), -1.0])
def test_a_push_that_is_no_number_is_refused(live, force):
    with pytest.raises(CableSenseError):
        live.loads_of(1, 0.0, force)


def test_a_busy_port_gives_the_next_and_a_foreign_host_a_remedy():
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        assert free_port("127.0.0.1", port) > port
    with pytest.raises(PageError, match="another --host or --port"):
        free_port("203.0.113.7", 8080)
