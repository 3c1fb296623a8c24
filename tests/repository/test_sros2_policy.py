"""The policy for a shared network: of the contract alone, with an enclave for every node."""

import re
from importlib import import_module
from xml.etree import ElementTree as ET

import pytest

from cablesense_base.installation import config_path
from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import RECORDED_TOPICS
from cablesense_ros.processes import node_command
from tests.helpers.checkout import CHECKOUT

POLICY = ET.parse(config_path("sros2/policy.xml")).getroot()
PROFILES = {
    enclave.get("path").removeprefix("/cablesense/"): enclave.find("profiles/profile")
    for enclave in POLICY.iter("enclave")
}
CONTRACT = {value for name, value in vars(topics).items() if name.isupper()}
OF_EVERY_NODE = {"rosout", "parameter_events", "clock", "~/transition_event"}
OF_ROS = {"diagnostics", "tf", "tf_static"}
OWN_SERVICES = re.compile(
    r"~/(describe|get|list|set)_parameters(_atomically)?|~/get_parameter_types"
    r"|~/get_type_description|~/(change_state|get_state|get_available_(states|transitions)"
    r"|get_transition_graph)"
)
OTHERS = {"record": "recorder", "sensor_check": "sensor_check", "operator": "operator"}


def names(profile, kind, right):
    """The topics or services that a profile has a right to, in the contract's words."""
    topics_named = set()
    for group in profile.findall(kind):
        if group.get(right) == "ALLOW":
            nodes = "estimator|breather|commissioner"
            topics_named |= {in_contract(entry.text, nodes) for entry in group}
    return topics_named


def in_contract(name, nodes):
    """A name as the contract has it, where one of the nodes and a segment may be in it."""
    return re.sub(r"/segment_\d+$", "/segment_{}", re.sub(f"^({nodes})/", "~/", name))


def test_every_node_has_an_enclave_and_nothing_else_has():
    setup = (CHECKOUT / "setup.py").read_text(encoding="utf-8")
    nodes = set(re.findall(r'"(\w+) = cablesense_ros\.programs:\w+"', setup))
    assert set(PROFILES) == nodes | set(OTHERS)
    for path, profile in PROFILES.items():
        assert profile.get("node") == OTHERS.get(path, path)
        assert profile.get("ns") == "/"


@pytest.mark.parametrize("path", PROFILES)
def test_every_topic_and_service_is_of_the_contract(path):
    profile = PROFILES[path]
    for right in ("publish", "subscribe"):
        given = names(profile, "topics", right) - OF_EVERY_NODE
        assert given <= CONTRACT | OF_ROS, given - CONTRACT
    for right in ("reply", "request"):
        for name in names(profile, "services", right):
            lifecycle = name.endswith("/change_state")
            assert name in CONTRACT or OWN_SERVICES.fullmatch(name) or lifecycle


def test_the_recorder_may_listen_to_what_a_recording_has():
    listens = names(PROFILES["record"], "topics", "subscribe") - {"clock", "parameter_events"}
    recorded = {topic.removeprefix("/") for topic in RECORDED_TOPICS}
    assert listens == recorded


@pytest.mark.parametrize(
    ("topic", "who"),
    [
        ("cable_tensions", {"sim", "can_driver"}),
        ("applied_wrench", {"page"}),
        ("~/wrench", {"estimator"}),
        ("calibration", {"commissioner"}),
        ("~/calibration", {"estimator"}),
    ],
)
def test_what_others_rest_on_few_may_publish(topic, who):
    assert {
        p for p, profile in PROFILES.items() if topic in names(profile, "topics", "publish")
    } == who


def test_only_the_page_and_an_operator_may_tare():
    asks = {p for p, r in PROFILES.items() if "~/tare" in names(r, "services", "request")}
    assert asks == {"page", "operator"}


NODES = {
    "sim": ("SimNode", {}),
    "breather": ("BreatherNode", {}),
    "commissioner": ("CommissionerNode", {"poses": 2}),
    "estimator": ("EstimatorNode", {}),
    "page": ("PageNode", {"port": 18100}),
    "can_driver": ("CanDriverNode", {"interface": "virtual", "channel": "policy"}),
    "can_emulator": ("CanEmulatorNode", {"interface": "virtual", "channel": "policy"}),
}
OF_SOME_RUNS = {
    "breather": {"cable_offsets"},  # with `over: cable_offsets`
    "estimator": {"~/estimate", "joint_states"},  # with cablesense_msgs; of measured joints
}
"""What a node asks for only where its parameters or the installation have it do so."""
RIGHTS = {
    "publisher": ("topics", "publish"),
    "subscriber": ("topics", "subscribe"),
    "service": ("services", "reply"),
    "client": ("services", "request"),
}


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", NODES)
def test_a_live_node_asks_for_what_the_policy_gives(name):
    rclpy = pytest.importorskip("rclpy")
    kind, parameters = NODES[name]
    rclpy.init(args=node_command(name, parameters)[3:])
    node = getattr(import_module(f"cablesense_ros.{name}_node"), kind)()
    try:
        getattr(node, "autostart", lambda: None)()
        for entity, (what, right) in RIGHTS.items():
            look = getattr(node, f"get_{entity}_names_and_types_by_node")
            seen = [topic for topic, _ in look(node.get_name(), node.get_namespace())]
            nodes = f"{name}|estimator|breather|commissioner"
            asked = {in_contract(topic.removeprefix("/"), nodes) for topic in seen}
            given = names(PROFILES[name], what, right)
            assert asked <= given, entity
            assert given - asked <= OF_EVERY_NODE | OF_SOME_RUNS.get(name, set()), entity
    finally:
        node.destroy_node()
        rclpy.utilities.try_shutdown()
