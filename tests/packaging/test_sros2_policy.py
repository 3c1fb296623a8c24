"""The policy for a shared network: of the contract alone, with an enclave for every node."""

import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from cablesense_base.installation import config_path
from cablesense_msgs_py import topics

POLICY = ET.parse(config_path("sros2/policy.xml")).getroot()
PROFILES = {
    enclave.get("path").removeprefix("/cablesense/"): enclave.find("profiles/profile")
    for enclave in POLICY.iter("enclave")
}
CONTRACT = {value for name, value in vars(topics).items() if name.isupper()}
OF_EVERY_NODE = {"rosout", "parameter_events", "clock", "~/transition_event"}
OWN_SERVICES = re.compile(
    r"~/(describe|get|list|set)_parameters(_atomically)?|~/get_parameter_types"
    r"|~/get_type_description|~/(change_state|get_state|get_available_(states|transitions)"
    r"|get_transition_graph)"
)
OTHERS = {"record": "recorder", "sensor_check": "sensor_check", "operator": "operator"}


def names(profile, kind, right):
    """The topics or services that a profile has a right to, in the contract's words."""
    found = set()
    for group in profile.findall(kind):
        if group.get(right) == "ALLOW":
            found |= {in_contract(entry.text, "estimator|breather") for entry in group}
    return found


def in_contract(name, nodes):
    """A name as the contract has it, where one of the nodes and a segment may be in it."""
    return re.sub(r"/segment_\d+$", "/segment_{}", re.sub(f"^({nodes})/", "~/", name))


def test_every_node_has_an_enclave_and_nothing_else_has():
    setup = (Path(__file__).parents[2] / "setup.py").read_text(encoding="utf-8")
    nodes = set(re.findall(r'"(\w+) = cablesense_ros\.\w+:main"', setup))
    assert set(PROFILES) == nodes | set(OTHERS)
    for path, profile in PROFILES.items():
        assert profile.get("node") == OTHERS.get(path, path)
        assert profile.get("ns") == "/"


@pytest.mark.parametrize("path", PROFILES)
def test_every_topic_and_service_is_of_the_contract(path):
    profile = PROFILES[path]
    for right in ("publish", "subscribe"):
        given = names(profile, "topics", right) - OF_EVERY_NODE
        assert given <= CONTRACT | {"diagnostics"}, given - CONTRACT
    for right in ("reply", "request"):
        for name in names(profile, "services", right):
            lifecycle = name.endswith("/change_state")
            assert name in CONTRACT or OWN_SERVICES.fullmatch(name) or lifecycle


@pytest.mark.parametrize(
    ("topic", "who"),
    [
        ("cable_tensions", {"sim", "can_driver"}),
        ("applied_wrench", {"page"}),
        ("~/wrench", {"estimator"}),
        ("~/journal", {"estimator"}),
    ],
)
def test_what_others_rest_on_few_may_publish(topic, who):
    assert {
        p for p, profile in PROFILES.items() if topic in names(profile, "topics", "publish")
    } == who


def test_only_the_page_and_an_operator_may_tare():
    asks = {p for p, r in PROFILES.items() if "~/tare" in names(r, "services", "request")}
    assert asks == {"page", "operator"}


LOOKS = """
import json, os, sys
import rclpy
rclpy.init(args=sys.argv)
module, name = sys.argv[1].rsplit(":", 1)
node = getattr(__import__(module, fromlist=[name]), name)()
getattr(node, "autostart", lambda: None)()
me = (node.get_name(), node.get_namespace())
seen = {}
for kind in ("publisher", "subscriber", "service", "client"):
    look = getattr(node, f"get_{kind}_names_and_types_by_node")
    seen[kind] = [topic for topic, _ in look(*me)]
print(json.dumps(seen), flush=True)
os._exit(0)
"""
NODES = {
    "sim": ("SimNode", []),
    "breather": ("BreatherNode", []),
    "estimator": ("EstimatorNode", []),
    "page": ("PageNode", ["-p", "port:=18100"]),
    "can_driver": ("CanDriverNode", ["-p", "interface:=virtual", "-p", "channel:=policy"]),
}
RIGHTS = {
    "publisher": ("topics", "publish"),
    "subscriber": ("topics", "subscribe"),
    "service": ("services", "reply"),
    "client": ("services", "request"),
}


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("name", NODES)
def test_a_live_node_asks_for_nothing_that_the_policy_does_not_give(name):
    pytest.importorskip("rclpy")
    kind, arguments = NODES[name]
    where = f"cablesense_ros.{name}_node:{kind}"
    done = subprocess.run(
        [sys.executable, "-c", LOOKS, where, "--ros-args", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr[-1500:]
    seen = json.loads(done.stdout.splitlines()[-1])
    for entity, (what, right) in RIGHTS.items():
        given = names(PROFILES[name], what, right)
        nodes = f"{name}|estimator|breather"
        asked = {in_contract(topic.removeprefix("/"), nodes) for topic in seen[entity]}
        assert asked <= given, asked - given
