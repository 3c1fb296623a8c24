"""Nodes find each other soon, unless the user has profiles of their own."""

import os
import subprocess
import sys
from xml.etree import ElementTree

import pytest

from cablesense_ros.discovery import PROFILES, RANGE, TRANSPORTS, own_graph, prefer_quick_discovery

FAST_DDS = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
NAMESPACE = {"dds": "http://www.eprosima.com"}
TALKER = """
import sys
from cablesense_ros.discovery import prefer_quick_discovery
if sys.argv[1] == "prefers":
    prefer_quick_discovery()
import rclpy
from std_msgs.msg import String
sent, taken = ("question", "reply") if sys.argv[2] == "asks" else ("reply", "question")
rclpy.init()
node = rclpy.create_node(sys.argv[2])
out = node.create_publisher(String, sent, 10)
received = []
node.create_subscription(String, taken, received.append, 10)
while sent == "reply" or not received:
    if sent == "question" or received:
        out.publish(String())
    rclpy.spin_once(node, timeout_sec=0.1)
"""
"""Asks until a reply comes, or replies for ever once it was asked."""


def parsed(environment):
    (path,) = {environment[name] for name in PROFILES}
    return ElementTree.parse(path)


@pytest.mark.parametrize("given", [{}, {RANGE: "LOCALHOST"}])
def test_the_bundled_profiles_announce_soon_and_repeat_soon(given):
    environment = {**FAST_DDS, **given}
    prefer_quick_discovery(environment)
    discovery = parsed(environment).find(".//dds:discovery_config", NAMESPACE)
    announced = discovery.find("dds:leaseAnnouncement", NAMESPACE)
    assert int(announced.find("dds:sec", NAMESPACE).text) == 0
    heartbeat = parsed(environment).find(".//dds:heartbeatPeriod", NAMESPACE)
    assert int(heartbeat.find("dds:sec", NAMESPACE).text) == 0


@pytest.mark.parametrize(
    "given",
    [{RANGE: "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}, {"ROS_LOCALHOST_ONLY": "1", RANGE: "OFF"}],
)
def test_this_machine_alone_is_loopback_udp_and_nothing_else(given):
    environment = {**FAST_DDS, **given}
    prefer_quick_discovery(environment)
    assert environment[RANGE] == "SYSTEM_DEFAULT"
    assert "ROS_LOCALHOST_ONLY" not in environment
    profile = parsed(environment)
    kinds = [
        kind.text for kind in profile.findall(".//dds:transport_descriptor/dds:type", NAMESPACE)
    ]
    allowed = profile.findall(".//dds:interfaceWhiteList/dds:address", NAMESPACE)
    assert kinds == ["UDPv4"]
    assert [address.text for address in allowed] == ["127.0.0.1"]
    assert profile.find(".//dds:useBuiltinTransports", NAMESPACE).text == "false"


@pytest.mark.parametrize(
    "given",
    [
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: "LOCALHOST"},
        {**FAST_DDS, "ROS_DISTRO": "kilted", RANGE: "LOCALHOST"},
    ],
)
def test_others_find_their_settings_untouched(given):
    environment = dict(given)
    prefer_quick_discovery(environment)
    assert environment == given


def test_shared_memory_on_this_machine_alone_for_who_asks_for_it():
    environment = {**FAST_DDS, RANGE: "LOCALHOST", TRANSPORTS: "DEFAULT"}
    prefer_quick_discovery(environment)
    assert environment[RANGE] == "LOCALHOST"
    assert environment[TRANSPORTS] == "DEFAULT"


def test_a_profile_of_the_user_stays():
    for name in PROFILES:
        environment = {name: "/etc/mine.xml"}
        prefer_quick_discovery(environment)
        assert environment == {name: "/etc/mine.xml"}


def test_an_empty_setting_is_none():
    environment = {**FAST_DDS, PROFILES[0]: ""}
    prefer_quick_discovery(environment)
    assert environment[PROFILES[0]].endswith("quick_discovery.xml")


def test_no_shared_memory_unless_the_user_wants_it():
    environment = dict(FAST_DDS)
    prefer_quick_discovery(environment)
    assert environment[TRANSPORTS] == "UDPv4"
    environment = {**FAST_DDS, TRANSPORTS: "DEFAULT"}
    prefer_quick_discovery(environment)
    assert environment[TRANSPORTS] == "DEFAULT"


def test_a_graph_of_its_own_has_a_domain_that_no_other_process_has():
    code = "from cablesense_ros.discovery import own_graph; print(own_graph()['ROS_DOMAIN_ID'])"
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert int(done.stdout) != int(os.environ["ROS_DOMAIN_ID"])
    assert own_graph()["ROS_DOMAIN_ID"] == os.environ["ROS_DOMAIN_ID"]


def test_the_domains_lock_file_causes_no_warning_at_exit():
    code = "from cablesense_ros.discovery import free_domain; free_domain()"
    command = [sys.executable, "-W", "always::ResourceWarning", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "ResourceWarning" not in done.stderr


@pytest.mark.ros
@pytest.mark.parametrize(("asker", "replier"), [("prefers", "plain"), ("plain", "prefers")])
@pytest.mark.parametrize("given", [{RANGE: "LOCALHOST"}, {}])
def test_who_prefers_it_and_who_does_not_hear_each_other(given, asker, replier):
    pytest.importorskip("rclpy")
    environment = {name: value for name, value in os.environ.items() if name != RANGE}
    environment |= given
    talker = [sys.executable, "-c", TALKER]
    with subprocess.Popen([*talker, replier, "replies"], env=environment) as other:
        try:
            subprocess.run([*talker, asker, "asks"], env=environment, timeout=20.0, check=True)
        finally:
            other.kill()
