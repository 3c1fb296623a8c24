"""Nodes find each other soon, and on this machine alone where that is asked for."""

import os
import socket
import struct
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cablesense_ros.processes import (
    PROFILES,
    RANGE,
    TRANSPORTS,
    Process,
    node_command,
    own_graph,
    prefer_quick_discovery,
    wait_until,
)

FAST_DDS = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
NAMESPACE = {"dds": "http://www.eprosima.com"}
FIRST_DDS_PORT = 7400
PORTS_OF_A_DOMAIN = 250


def profile_of(environment):
    (path,) = {environment[name] for name in PROFILES}
    return ElementTree.parse(path)


@pytest.mark.parametrize("given", [{}, {RANGE: "LOCALHOST"}])
def test_the_bundled_profiles_announce_soon_and_repeat_soon(given):
    environment = {**FAST_DDS, **given}
    prefer_quick_discovery(environment)
    profile = profile_of(environment)
    for period in (".//dds:discovery_config/dds:leaseAnnouncement", ".//dds:heartbeatPeriod"):
        assert int(profile.find(f"{period}/dds:sec", NAMESPACE).text) == 0


@pytest.mark.parametrize(
    "given",
    [{RANGE: "LOCALHOST"}, {"ROS_LOCALHOST_ONLY": "1"}, {"ROS_LOCALHOST_ONLY": "1", RANGE: "OFF"}],
)
def test_this_machine_alone_is_loopback_udp_and_nothing_else(given):
    environment = {**FAST_DDS, **given}
    prefer_quick_discovery(environment)
    assert environment[RANGE] == "SYSTEM_DEFAULT"
    assert "ROS_LOCALHOST_ONLY" not in environment
    profile = profile_of(environment)
    kinds = profile.findall(".//dds:transport_descriptor/dds:type", NAMESPACE)
    allowed = profile.findall(".//dds:interfaceWhiteList/dds:address", NAMESPACE)
    assert [kind.text for kind in kinds] == ["UDPv4"]
    assert [address.text for address in allowed] == ["127.0.0.1"]
    assert profile.find(".//dds:useBuiltinTransports", NAMESPACE).text == "false"


@pytest.mark.parametrize(
    "given",
    [
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: "LOCALHOST"},
        {**FAST_DDS, "ROS_DISTRO": "kilted", RANGE: "LOCALHOST"},
        {PROFILES[0]: "/etc/mine.xml"},
    ],
)
def test_settings_of_others_stay_untouched(given):
    environment = dict(given)
    prefer_quick_discovery(environment)
    assert environment == given


@pytest.mark.parametrize("wanted", [{}, {RANGE: "LOCALHOST"}])
def test_no_shared_memory_unless_the_user_wants_it(wanted):
    environment = {**FAST_DDS, PROFILES[0]: ""}
    prefer_quick_discovery(environment)
    assert environment[TRANSPORTS] == "UDPv4"
    environment = {**FAST_DDS, TRANSPORTS: "DEFAULT", **wanted}
    prefer_quick_discovery(environment)
    assert environment[TRANSPORTS] == "DEFAULT"
    assert environment.get(RANGE) == wanted.get(RANGE)


def test_a_graph_of_its_own_has_a_domain_that_no_other_process_has():
    code = "from cablesense_ros.processes import own_graph; print(own_graph()['ROS_DOMAIN_ID'])"
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    command = [sys.executable, "-W", "always::ResourceWarning", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert int(done.stdout) != int(os.environ["ROS_DOMAIN_ID"])
    assert "ResourceWarning" not in done.stderr
    assert own_graph()["ROS_DOMAIN_ID"] == os.environ["ROS_DOMAIN_ID"]


def bound(pid):
    """(kind, address, port) of every socket of a process that waits for others."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            inodes.add(str(link.readlink()).removeprefix("socket:[").removesuffix("]"))
        except OSError:  # closed in the meantime
            continue
    addresses = set()
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes and (kind.startswith("udp") or fields[3] == "0A"):
                number, port = fields[1].split(":")
                packed = b"".join(
                    struct.pack("<I", int(number[i : i + 8], 16)) for i in range(0, len(number), 8)
                )
                family = socket.AF_INET if len(packed) == 4 else socket.AF_INET6
                addresses.add((kind, socket.inet_ntop(family, packed), int(port, 16)))
    return addresses


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="looks in Linux's /proc")
def test_a_node_of_the_demo_waits_on_loopback_alone(monkeypatch, tmp_path):
    for variable in (RANGE, *PROFILES):
        monkeypatch.delenv(variable, raising=False)
    environment = own_graph()
    first = FIRST_DDS_PORT + PORTS_OF_A_DOMAIN * int(environment["ROS_DOMAIN_ID"])
    command = node_command("page", {"port": 18080})
    with Process("page", command, tmp_path / "log", environment) as node:
        wait_until(lambda: "page: " in node.log, 60.0, "the page is not ready", node.check)
        addresses = bound(node.pid)
    assert len([kind for kind, _, _ in addresses if kind.startswith("tcp")]) == 1
    assert any(first <= port < first + PORTS_OF_A_DOMAIN for _, _, port in addresses)
    assert {address for _, address, _ in addresses} <= {"127.0.0.1", "::1"}
