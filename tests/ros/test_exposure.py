"""Which addresses are of this machine alone, and where each server of the demo really waits."""

import socket
import struct
import time
from pathlib import Path

import pytest

from cablesense_online.page.page import exposure_warning
from cablesense_ros.discovery import PROFILES, own_graph
from cablesense_ros.processes import Process, node_command, wait_until

LISTENING = "0A"
FIRST_DDS_PORT, PORTS_OF_A_DOMAIN = 7400, 250
LOOPBACK = ("127.0.0.1", "::1")


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.0.1", "localhost", "::1"])
def test_loopback_is_no_exposure(host):
    assert exposure_warning(host, 8080, controls=True) == ""


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.7", "::", "robot", "", "127.0.0.1.x"])
def test_any_other_host_is_one_line_of_warning(host):
    line = exposure_warning(host, 8080, controls=True)
    assert line.endswith("given its address, or listens in on the way, can see and move the arm")
    assert len(line.splitlines()) == 1
    assert "move" not in exposure_warning(host, 8080, controls=False)


def test_the_demo_keeps_dds_on_this_machine_unless_set_otherwise(monkeypatch):
    nothing_set(monkeypatch)
    environment = own_graph()
    assert {Path(environment[name]).name for name in PROFILES} == {"loopback.xml"}
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    environment = own_graph()
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert {Path(environment[name]).name for name in PROFILES} == {"quick_discovery.xml"}


def nothing_set(monkeypatch):
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", *PROFILES):
        monkeypatch.delenv(name, raising=False)


def bound(pid):
    """(kind, address, port) of every socket of a process that waits for others."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            inodes.add(str(link.readlink()).removeprefix("socket:[").removesuffix("]"))
        except OSError:  # closed in the meantime
            continue
    found = []
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            fields = line.split()
            waits = fields[3] == LISTENING if kind.startswith("tcp") else True
            if fields[9] in inodes and waits:
                number, port = fields[1].split(":")
                packed = b"".join(
                    struct.pack("<I", int(number[i : i + 8], 16)) for i in range(0, len(number), 8)
                )
                family = socket.AF_INET if len(packed) == 4 else socket.AF_INET6
                found.append((kind, socket.inet_ntop(family, packed), int(port, 16)))
    return found


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="looks in Linux's /proc")
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("page", {"port": 18080}),
        ("sim", {}),
        ("estimator", {}),
        ("can_driver", {"interface": "virtual", "channel": "exposure"}),
    ],
)
def test_nodes_of_the_demo_wait_on_loopback_alone(name, parameters, monkeypatch, tmp_path):
    pytest.importorskip("rclpy")
    nothing_set(monkeypatch)
    environment = own_graph()
    domain = int(environment["ROS_DOMAIN_ID"])
    first = FIRST_DDS_PORT + PORTS_OF_A_DOMAIN * domain
    with Process(name, node_command(name, parameters), tmp_path / "log", environment) as node:

        def waiting():
            return set(bound(node.pid))

        wanted = "tcp" if name == "page" else "udp"
        wait_until(
            lambda: any(kind == wanted for kind, _, _ in waiting()),
            30.0,
            f"{name} waits nowhere",
            node.check,
        )
        time.sleep(1.0)
        found = waiting()
    listening = {entry for entry in found if entry[0].startswith("tcp")}
    assert len(listening) == (name == "page")
    assert any(first <= port < first + PORTS_OF_A_DOMAIN for _, _, port in found)
    assert {address for _, address, _ in found} <= set(LOOPBACK)


@pytest.mark.ros
@pytest.mark.slow
def test_the_page_says_when_it_is_open_to_the_network(tmp_path):
    pytest.importorskip("rclpy")
    command = node_command("page", {"port": 18090, "host": "0.0.0.0"})
    with Process("page", command, tmp_path / "log", own_graph()) as node:
        wait_until(lambda: "page: " in node.log, 30.0, "no page", node.check)
        assert node.log.count("without encryption") == 1
