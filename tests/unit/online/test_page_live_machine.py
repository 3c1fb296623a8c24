"""The state that the page shows, made of the contract's messages."""

from types import SimpleNamespace as Message

import numpy as np
import pytest

from cablesense_base import CableSenseError
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import Contact, ForceState, Level, breath_frame
from cablesense_online.page.live_machine import STALE_S, LiveMachine
from cablesense_online.page.shown_arm import ShownArm
from cablesense_online.page.shown_model import ShownModel
from cablesense_online.page.snapshot import ForceBounds, PlaceInterval
from cablesense_online.placed_links import PlacedLinks
from cablesense_sim.arm import open_arm
from tests.helpers.example_machines import example_machine

ARM = open_arm("cdsm")
TENSIONS = Message(name=list(ARM.cable_names), effort=[50.0] * 12)


@pytest.fixture
def live():
    return LiveMachine(ShownArm(ARM), joint_speed_rad_s=1.0)


@pytest.fixture(params=["finger", "continuum", "six_axis"])
def live_model(request):
    """A machine with commanded joints, with commanded actuators, and with measured joints."""
    shown = ShownModel(example_machine(request.param))
    return LiveMachine(shown, joint_speed_rad_s=1.0)


def vector(x, y, z):
    return Message(x=float(x), y=float(y), z=float(z))


def wrench(frame, force=(0, 0, 0), torque=(0, 0, 0)):
    pair = Message(force=vector(*force), torque=vector(*torque))
    return Message(header=Message(frame_id=frame), wrench=pair)


def command(first_rad):
    position = [first_rad, *[0.0] * 7]
    return Message(header=Message(frame_id=""), name=list(ARM.joint_names), position=position)


def receive(live, state, now_s, **wrenches):
    """Tensions, a `status` and wrenches arrive, those by the names of their topics."""
    header = Message(stamp=Message(sec=1, nanosec=0))
    live.take(topics.CABLE_TENSIONS, TENSIONS, now_s)
    status = Message(header=header, status=[Message(message=state.value)])
    live.take(topics.STATUS, status, now_s)
    for name, message in wrenches.items():
        live.take(getattr(topics, name), message, now_s)


def push(live, *message):
    live.take(topics.APPLIED_WRENCH, wrench(*message), 0.0)
    return live.snapshot(0.0).true


def test_a_push_makes_the_true_contact_that_was_asked_for(live):
    contact = Contact(3, 120.0, 40.0, 0.065, 8.0)
    (load,) = live.loads_of(contact)
    frame, torque_n_m = live.load_frame(load)
    assert frame == "segment_3"  # at the contact point
    (true,) = push(live, frame, load.force_base_n, torque_n_m)
    assert true[:5] == pytest.approx(contact[:5])


@pytest.mark.parametrize("bent", [False, True])
def test_a_push_anywhere_comes_back_from_its_wrench_about_the_base(live, bent):
    if bent:
        states = Message(name=list(ARM.joint_names), position=np.linspace(-0.1, 0.12, 8).tolist())
        live.take(topics.JOINT_STATES, states, 0.0)
        live.take(topics.JOINT_COMMANDS, command(0.05), 0.0)
    contact = Contact(2, 200.0, 30.0, 0.11, -5.0)
    (load,) = live.loads_of(contact)
    frame, torque_n_m = live.load_frame(load)
    assert frame == "base_link"
    (true,) = push(live, frame, load.force_base_n, torque_n_m)
    assert true[:5] == pytest.approx(contact[:5])
    for numbers in ((2, 0.0, 1.0, 0.2, 0.0), (2, 0.0, 1.0, 0.1, np.nan), (2, 0.0, 1.0, np.nan, 0)):
        with pytest.raises(CableSenseError, match=r"segment 2"):
            live.loads_of(Contact(*numbers))


def test_a_push_on_a_link_comes_back_from_its_message_wherever_the_machine_is(live_model):
    shown = live_model.shown
    felt = shown.felt
    number = len(shown.words.links)
    pose = shown.pose_of(felt.first_command) + np.linspace(-0.1, 0.1, len(felt.torque_names))
    states = Message(name=list(felt.torque_names), position=pose.tolist())
    live_model.take(topics.JOINT_STATES, states, 0.0)
    place_m = float(shown.touched_m[-1] @ [0.3, 0.7])
    contact = Contact(number, 200.0, 0.3 * shown.strongest_n, place_m, -0.05 * shown.strongest_n)
    (load,) = live_model.loads_of(contact)
    frame, torque_n_m = live_model.load_frame(load)
    assert frame == shown.words.links[-1]
    (true,) = push(live_model, frame, load.force_base_n, torque_n_m)
    assert true[:5] == pytest.approx(contact[:5])


def test_an_estimate_in_the_frame_of_a_body_is_shown_along_its_link(live_model):
    shown = live_model.shown
    felt = shown.felt
    number = len(shown.words.links)
    contact = Contact(number, 75.0, 4.0, float(shown.usual_m[-1]), 0.5)
    placed = PlacedLinks(felt.link_frames)
    stated = placed.wrench(number, contact.wrench)
    ends_m = [placed.point(number, place_m) for place_m in shown.touched_m[-1]]
    points = [vector(*end_m) for end_m in reversed(ends_m)]
    frame = shown.words.links[-1]
    names = list(felt.channels.names)
    tensions = Message(name=names, effort=[50.0] * len(names))
    live_model.take(topics.CABLE_TENSIONS, tensions, 1.0)
    header = Message(stamp=Message(sec=1, nanosec=0))
    status = Message(header=header, status=[Message(message=ForceState.CONTACT.value)])
    live_model.take(topics.STATUS, status, 1.0)
    live_model.take(topics.WRENCH, wrench(frame, stated[:3], stated[3:]), 1.0)
    polygon = Message(header=Message(frame_id=frame), polygon=Message(points=points))
    live_model.take(topics.CONTACT_REGION, polygon, 1.0)
    now = live_model.snapshot(1.0)
    (estimated,) = now.estimated
    assert estimated[:5] == pytest.approx(contact[:5])
    assert now.region == (pytest.approx((number, *shown.touched_m[-1])),)
    assert now.status.headline == f"Contact on {frame}"


def test_a_push_releases_the_previous_one_unless_both_are_wanted(live):
    push(live, "segment_2", (0, 0, 10))
    released, pushed = live.loads_of(Contact(4, 0.0, 15.0))
    assert (released.segment, pushed.segment) == (2, 4)
    assert not released.force_base_n.any()
    (pushed,) = live.loads_of(Contact(4, 0.0, 15.0), beside=True)
    assert [each.segment for each in push(live, "segment_4", pushed.force_base_n)] == [4, 2]


def test_what_cannot_be_is_refused_and_changes_nothing(live):
    for frame in ("segment_5", "segment_0", "world", ""):
        with pytest.raises(CableSenseError, match="frame_id"):
            push(live, frame, (0, 0, 1))
    for force_n in (np.nan, np.inf, -1.0):
        with pytest.raises(CableSenseError):
            live.loads_of(Contact(1, 0.0, force_n))
    with pytest.raises(CableSenseError, match="plates touch"):
        live.take(topics.JOINT_COMMANDS, command(0.6), 0.0)
    live.snapshot(0.0)
    assert live.snapshot(30.0).true == ()
    assert not live.snapshot(30.0).pose.any()


def test_the_commands_of_a_breath_move_no_arm_on_the_page(live):
    breathed = command(0.1)
    breathed.header.frame_id = breath_frame(3)
    live.take(topics.JOINT_COMMANDS, breathed, 0.0)
    live.snapshot(0.0)
    assert not live.snapshot(30.0).pose.any()


def test_contacts_of_several_segments_are_shown_and_old_ones_are_not(live):
    on_segment = topics.SEGMENT_WRENCHES.format
    live.take(on_segment(1), wrench("segment_1", (0, 9, 0)), 1.0 - 2 * STALE_S)
    live.take(on_segment(2), wrench("segment_2", (0, 10, 0)), 1.0)
    live.take(on_segment(3), wrench("segment_3"), 1.0)
    live.take(on_segment(4), wrench("segment_4", (0, 0, 30)), 1.0)
    receive(live, ForceState.CONTACT, 1.0, WRENCH=wrench("segment_4", (0, 0, 30)))
    shown = live.snapshot(1.0)
    assert [each.segment for each in shown.estimated] == [4, 2]
    assert shown.estimated[0].magnitude_n == pytest.approx(30.0)
    assert shown.status.headline == "Contact on segments 2 and 4"


def test_an_estimate_is_in_the_axes_of_the_commanded_pose(live):
    live.take(topics.JOINT_COMMANDS, command(np.pi / 6), 0.0)
    live.snapshot(0.0)
    receive(live, ForceState.CONTACT, 30.0, WRENCH=wrench("segment_1", (0, 0, 10)))
    shown = live.snapshot(30.0)
    (estimate,) = shown.estimated
    assert estimate.angle_deg == pytest.approx(0.0)
    np.testing.assert_allclose(shown.frame_pose, [np.pi / 6, *[0.0] * 7], atol=1e-12)


def test_old_estimates_and_old_tensions_are_not_shown_as_the_present(live):
    assert live.snapshot(0.0).status.level is Level.STALE
    receive(live, ForceState.CONTACT, 1.0, WRENCH=wrench("segment_1", (0, 5, 0)))
    assert live.snapshot(1.1).status.headline == "Contact on segment 1"
    live.take(topics.CABLE_TENSIONS, TENSIONS, 2.0)
    later = live.snapshot(1.0 + 2 * STALE_S)
    assert (later.estimated, later.state) == ((), ForceState.SILENT)
    assert later.status.level is Level.STALE
    assert "silent" in later.status.headline
    assert "Readings are stale" in live.snapshot(3.0).status.headline


@pytest.mark.parametrize("state", [each for each in ForceState if not each.known])
def test_what_is_not_known_is_never_shown_as_no_contact(live, state):
    receive(live, state, 1.0, WRENCH=wrench("base_link"))
    shown = live.snapshot(1.0)
    assert shown.status.headline != "No contact"
    assert shown.status.level is not Level.OK
    assert shown.probabilities is None


def test_the_stated_interval_is_that_between_two_wrenches(live):
    upper = wrench("segment_2", (0, 3, -4))
    receive(live, ForceState.HIDDEN, 1.0, WRENCH_UPPER=upper)
    assert live.snapshot(1.0).bounds is None
    live.take(topics.WRENCH_LOWER, wrench("base_link"), 1.0)
    shown = live.snapshot(1.0)
    assert shown.bounds == ForceBounds(0.0, 5.0)  # of any direction
    assert "up to 5.0 N" in shown.status.headline
    live.take(topics.WRENCH_LOWER, wrench("segment_3", (0, 3, 3)), 1.0)
    live.take(topics.WRENCH_UPPER, wrench("segment_3", (0, 4, 0)), 1.0)
    bounds = live.snapshot(1.0).bounds
    assert bounds.angles_deg == pytest.approx((45.0, 90.0))
    assert bounds.high_n == pytest.approx(4.0)


def region(frame, *places_m):
    points = [Message(x=place_m, y=0.0, z=0.0) for place_m in places_m]
    return Message(header=Message(frame_id=frame), polygon=Message(points=points))


def test_an_estimate_acts_where_its_torque_says_within_its_region(live):
    force = np.array([2.0, 20.0, -10.0])
    stated = wrench("segment_3", force, np.cross([0.09, 0.0, 0.0], force))
    receive(live, ForceState.CONTACT, 1.0, WRENCH=stated)
    live.take(topics.CONTACT_REGION, region("segment_3", 0.094, 0.086), 1.0)
    shown = live.snapshot(1.0)
    (estimated,) = shown.estimated
    assert (estimated.contact_m, estimated.along_n) == (pytest.approx(0.09), 2.0)
    assert estimated.magnitude_n == pytest.approx(np.hypot(20.0, 10.0))
    assert shown.region == (pytest.approx(PlaceInterval(3, 0.086, 0.094)),)
    receive(live, ForceState.FREE, 1.1)
    assert live.snapshot(1.1).region == ()


def test_a_region_goes_on_along_the_neighbouring_segments_and_ends_with_the_arm(live):
    push_n = wrench("segment_3", (0, 20, 0), (0, 0, 1))
    receive(live, ForceState.CONTACT, 1.0, WRENCH=push_n)
    live.take(topics.CONTACT_REGION, region("segment_3", -0.02, 0.3), 1.0)
    parts = live.snapshot(1.0).region
    assert [part.segment for part in parts] == [2, 3, 4]
    assert parts[0] == pytest.approx((2, 0.11, 0.13))
    assert parts[-1] == pytest.approx((4, 0.0, 0.13))


def test_of_a_moment_one_sentence_states_what_is_known(live):
    force = np.array([0.0, 3.0, 4.0])
    moment = wrench("segment_1", (0, 0, 0), np.cross([0.64, 0.0, 0.0], force))
    low, high = (wrench("segment_1", size * force) for size in (4.0, 18.0))
    receive(live, ForceState.MOMENT, 1.0, WRENCH=moment, WRENCH_LOWER=low, WRENCH_UPPER=high)
    live.take(topics.CONTACT_REGION, region("segment_1", 0.02, 0.13), 1.0)
    shown = live.snapshot(1.0)
    assert shown.estimated == ()
    known = Contact(1, np.degrees(np.arctan(0.75)), moment_n_m=3.2)
    assert shown.known_by_moment == pytest.approx(known)
    assert shown.region == (pytest.approx(PlaceInterval(1, 0.02, 0.13)),)
    sentence = "segment 1: moment 3.2 N·m known, force between 20 and 90 N"
    assert shown.status.headline == f"Contact on {sentence}"
    assert shown.status.level is Level.OK


@pytest.mark.parametrize(
    ("part", "level", "shown"),
    [
        ("cables", Level.WARN, Level.OK),  # lessens no trust
        ("cable_tensions", Level.ERROR, Level.ERROR),
        ("tare", Level.WARN, Level.WARN),
    ],
)
def test_warnings_are_notes_and_those_that_lessen_trust_colour_the_state(live, part, level, shown):
    receive(live, ForceState.FREE, 1.0)
    diagnose(live, f"estimator: {part}", level, "as it is")
    assert live.reports_ok(part) is False
    status = live.snapshot(1.0).status
    assert (status.level, status.notes) == (shown, ("as it is",))


def diagnose(live, name, level, message, **values):
    """A status of a node comes; keys of values with spaces for underscores."""
    pairs = [Message(key=key.replace("_", " "), value=value) for key, value in values.items()]
    status = Message(name=name, level=bytes([level]), message=message, values=pairs)
    live.take(topics.DIAGNOSTICS, Message(status=[status]), 1.0)


def test_the_sentence_of_a_refusal_is_shown_in_place_of_its_kind(live):
    receive(live, ForceState.IMPLAUSIBLE, 1.0)
    sentence = "readings fit no contact: cable_7 reads 3.0 N too much"
    diagnose(
        live, "estimator: cable_tensions", Level.ERROR, "samples refused", last_refusal=sentence
    )
    shown = live.snapshot(1.0).status
    assert shown.headline == "Readings fit no contact: no estimate"
    assert shown.notes == (sentence,)


def test_how_well_the_arm_is_known_is_shown_while_it_is(live):
    receive(live, ForceState.FREE, 1.0)
    assert live.snapshot(1.0).machine_known == ""
    diagnose(live, "estimator: tare", Level.OK, "known by 1 tare")
    assert live.snapshot(1.0).machine_known == "known by 1 tare"
    assert live.snapshot(9.0).machine_known == ""
    diagnose(live, "estimator: tare", Level.WARN, "it is not as described")
    shown = live.snapshot(1.0)
    assert shown.machine_known == ""
    assert shown.status.notes == ("it is not as described",)


def test_a_commissioning_is_shown_while_it_lasts_and_its_end_is_known(live):
    receive(live, ForceState.FREE, 1.0)
    name = "commissioner: commissioning"
    diagnose(live, name, Level.OK, "none yet")
    assert (live.snapshot(1.0).commissioning, live.commissioned) == (None, None)
    values = {"holds": "3 of 8", "left_(s)": "20"}
    diagnose(live, name, Level.OK, "at rest", **values)
    assert live.snapshot(1.0).commissioning == (3, 8)
    assert live.commissioned is None
    diagnose(live, name, Level.ERROR, "stopped: something touches segment 2", holds="3 of 8")
    shown = live.snapshot(1.0)
    assert shown.commissioning is None
    assert live.commissioned == "stopped: something touches segment 2"
    assert shown.status.notes == (live.commissioned,)
    assert shown.status.level is Level.OK  # the estimate is as good as before


def test_the_interval_of_an_untouched_arm_is_of_no_force(live):
    ends = {"WRENCH_LOWER": wrench("base_link"), "WRENCH_UPPER": wrench("segment_1", (0, 19, 0))}
    receive(live, ForceState.FREE, 1.0, **ends)
    assert live.snapshot(1.0).bounds is None


@pytest.mark.parametrize("topic", [topics.WRENCH_BASE, topics.SEGMENT_WRENCHES.format(5), "wind"])
def test_a_message_of_another_topic_is_refused_and_named(live, topic):
    before = live.snapshot(0.0)
    with pytest.raises(CableSenseError, match=topic):
        live.take(topic, wrench("segment_3", (0, 3, 3)), 0.0)
    assert live.snapshot(0.0).estimated == before.estimated
