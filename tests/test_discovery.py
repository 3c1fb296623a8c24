"""Nodes find each other soon, unless the user has profiles of their own."""

from xml.etree import ElementTree

from cablesense_ros.discovery import PROFILES, TRANSPORTS, prefer_quick_discovery


def test_the_bundled_profile_is_used():
    environment = {}
    prefer_quick_discovery(environment)
    (path,) = {environment[name] for name in PROFILES}
    namespace = {"dds": "http://www.eprosima.com"}
    discovery = ElementTree.parse(path).find(".//dds:discovery_config", namespace)
    announced = discovery.find("dds:leaseAnnouncement", namespace)
    assert int(announced.find("dds:sec", namespace).text) == 0


def test_a_profile_of_the_user_stays():
    for name in PROFILES:
        environment = {name: "/etc/mine.xml"}
        prefer_quick_discovery(environment)
        assert environment == {name: "/etc/mine.xml"}


def test_an_empty_setting_is_none():
    environment = {PROFILES[0]: ""}
    prefer_quick_discovery(environment)
    assert environment[PROFILES[0]].endswith("quick_discovery.xml")


def test_no_shared_memory_unless_the_user_wants_it():
    environment = {}
    prefer_quick_discovery(environment)
    assert environment[TRANSPORTS] == "UDPv4"
    environment = {TRANSPORTS: "DEFAULT"}
    prefer_quick_discovery(environment)
    assert environment[TRANSPORTS] == "DEFAULT"
