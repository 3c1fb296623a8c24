"""The state that the page shows, its port, and the errors it adds up."""

import dataclasses
import socket
from types import SimpleNamespace as Message

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_msgs_py.messages import Level
from cablesense_online.page.live_arm import (
    STALE_S,
    Contact,
    LiveArm,
    Score,
    Snapshot,
    Status,
    angle_error_deg,
)
from cablesense_online.page.page import PageError, free_port
from cablesense_sim.arm import open_arm

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


def test_a_push_makes_the_true_contact_that_was_asked_for(live):
    for load in live.loads_of(3, 120.0, 40.0):
        live.on_load(wrench(f"segment_{load.segment}", load.force_base_n))
    true = live.snapshot(0.0).true
    assert (true.segment, true.magnitude_n) == (3, pytest.approx(40.0))
    assert true.angle_deg == pytest.approx(120.0)


def test_a_push_elsewhere_releases_the_one_before(live):
    live.on_load(wrench("segment_2", (0.0, 0.0, 10.0)))
    released, pushed = live.loads_of(4, 0.0, 5.0)
    assert released.segment == 2
    assert not released.force_base_n.any()
    assert pushed.segment == 4


def command(first_rad):
    names, others = list(ARM.joint_names), [0.0] * 7
    return Message(header=Message(frame_id=""), name=names, position=[first_rad, *others])


def test_an_estimate_is_turned_into_base_axes_at_the_commanded_pose(live):
    live.on_joint_commands(command(np.pi / 6))
    for now_s in (0.0, 30.0):
        live.snapshot(now_s)
    live.on_tensions(tensions(), 30.0)
    live.on_wrench(wrench("segment_1", (0.0, 0.0, 10.0)), 30.0)
    estimate = live.snapshot(30.0).estimate
    assert estimate.angle_deg == pytest.approx(0.0)
    expected = [10.0 * np.sin(np.pi / 6), 0.0, 10.0 * np.cos(np.pi / 6)]
    np.testing.assert_allclose(estimate.force_base_n, expected, atol=1e-9)


def test_old_estimates_and_old_tensions_are_not_shown_as_the_present(live):
    assert live.snapshot(0.0).status.level is Level.STALE
    live.on_tensions(tensions(), 1.0)
    live.on_wrench(wrench("segment_1", (0.0, 5.0, 0.0)), 1.0)
    assert live.snapshot(1.1).status.headline == "Contact on segment 1"
    live.on_tensions(tensions(), 2.0)
    later = live.snapshot(1.0 + 2 * STALE_S)
    assert later.estimate is None
    assert later.status.level is Level.STALE


@pytest.mark.parametrize("frame", ["segment_5", "segment_0", "base_link", ""])
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


OK = Status(Level.OK, "fine")


def contact(segment=2, angle=350.0, newtons=40.0):
    return Contact(segment, angle, newtons, np.array([0.0, 0.0, newtons]))


def moment(time_s, true, estimate, status=OK, pose=0.0):
    return Snapshot(time_s, np.full(8, pose), np.full(12, 50.0), true, estimate, None, status)


def test_angles_wrap_around():
    assert angle_error_deg(359.0, 1.0) == pytest.approx(2.0)
    assert angle_error_deg(10.0, 200.0) == pytest.approx(170.0)


def test_errors_are_means_over_steady_moments():
    score = Score(settling_s=1.0)
    true, estimate = contact(angle=350.0, newtons=40.0), contact(angle=4.0, newtons=41.0)
    for time_s in np.arange(0.0, 3.0, 0.1):
        score.add(moment(time_s, true, estimate))
    errors = score.errors
    assert errors.segment_right == 1.0
    assert errors.angle_mae_deg == pytest.approx(14.0)
    assert errors.magnitude_mae_n == pytest.approx(1.0)
    assert errors.count == 20


def test_a_wrong_segment_counts_against_the_share_alone():
    score = Score(settling_s=0.0)
    score.add(moment(0.0, contact(2), contact(3)))
    score.add(moment(0.1, contact(2), contact(2)))
    assert score.errors.segment_right == 0.5
    assert score.errors.angle_mae_deg == 0.0


def test_silence_about_nothing_is_right_and_about_a_push_is_wrong():
    score = Score(settling_s=0.0)
    score.add(moment(0.0, None, None))
    assert score.errors.segment_right == 1.0
    assert score.errors.angle_mae_deg is None
    score.add(moment(1.0, contact(), None))
    assert score.errors.segment_right == 0.5


@pytest.mark.parametrize("change", ["load", "pose"])
def test_a_change_starts_the_settling_anew(change):
    score = Score(settling_s=1.0)
    before = moment(0.0, contact(), contact())
    score.add(before)
    assert score.add(dataclasses.replace(before, time_s=1.5))
    after = (
        moment(1.6, contact(newtons=60.0), contact())
        if change == "load"
        else moment(1.6, contact(), contact(), pose=0.05)
    )
    assert not score.add(after)
    assert not score.add(dataclasses.replace(after, time_s=2.5))
    assert score.add(dataclasses.replace(after, time_s=2.7))


def test_stale_estimates_are_not_judged():
    score = Score(settling_s=0.0)
    assert not score.add(moment(0.0, None, None, Status(Level.STALE, "silent")))
    assert score.errors.segment_right is None
