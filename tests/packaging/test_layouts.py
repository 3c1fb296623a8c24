"""Layouts for RViz, Foxglove and PlotJuggler: well formed, and every topic is of the contract."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET

import pytest
import yaml

from cablesense_base.installation import config_path
from cablesense_msgs_py.qos import CONTRACT, resolved
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
KINDS = {resolved(topic): of.kind for topic, of in CONTRACT.items()}
FIELDS = {
    "/cable_tensions": r"effort\[(\d|1[01])\]",
    "/joint_states": r"position\[[0-7]\]",
    "/estimator/wrench": r"wrench\.force\.[xyz]",
    "/estimator/contact_probabilities": r"data\[[0-4]\]",
}


@pytest.fixture(scope="module")
def rviz():
    return yaml.safe_load(config_path("layouts/cablesense.rviz").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def foxglove():
    text = config_path("layouts/cablesense_foxglove.json").read_text(encoding="utf-8")
    return json.loads(text)


@pytest.fixture(scope="module")
def plotjuggler():
    return ET.parse(config_path("layouts/cablesense_plotjuggler.xml")).getroot()


def test_rviz_shows_the_arm_and_the_contact(rviz):
    manager = rviz["Visualization Manager"]
    displays = {display["Class"].removeprefix("rviz_default_plugins/"): display
                for display in manager["Displays"]}  # fmt: skip
    topic = {
        "RobotModel": displays["RobotModel"]["Description Topic"],
        "MarkerArray": displays["MarkerArray"]["Topic"],
        "Wrench": displays["Wrench"]["Topic"],
    }
    assert {name: KINDS[of["Value"]].rpartition("/")[2] for name, of in topic.items()} == {
        "RobotModel": "String",
        "MarkerArray": "MarkerArray",
        "Wrench": "WrenchStamped",
    }
    assert topic["RobotModel"]["Durability Policy"] == "Transient Local"
    assert manager["Global Options"]["Fixed Frame"] == "base_link"
    assert manager["Views"]["Current"]["Class"] == "rviz_default_plugins/Orbit"


def test_foxglove_panels_are_placed_once_and_read_topics_that_exist(foxglove):
    assert set(foxglove) == {
        "configById", "globalVariables", "userNodes", "playbackConfig", "layout",
    }  # fmt: skip
    panels = foxglove["configById"]
    assert sorted(placed(foxglove["layout"])) == sorted(panels)
    assert {name.partition("!")[0] for name in panels} == {
        "3D", "Plot", "DiagnosticSummary", "RawMessages",
    }  # fmt: skip
    for name, panel in panels.items():
        for path in panel.get("paths", []):
            topic, _, field = path["value"].partition(".")
            assert topic in KINDS, name
            assert re.fullmatch(FIELDS[topic], field), path
    scene = panels["3D!arm"]
    assert set(scene["topics"]) <= set(KINDS)
    layer = scene["layers"]["arm"]
    assert KINDS[layer["topic"]] == "std_msgs/msg/String"
    assert KINDS[layer["jointStatesTopic"]] == "sensor_msgs/msg/JointState"
    health = panels["DiagnosticSummary!health"]
    assert KINDS[health["topicToRender"]] == "diagnostic_msgs/msg/DiagnosticArray"
    assert panels["RawMessages!wrench"]["topicPath"] in KINDS


def placed(node):
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column")
    return placed(node["first"]) + placed(node["second"])


def test_plotjuggler_curves_are_series_of_the_contract(plotjuggler):
    assert [tab.get("tab_name") for tab in plotjuggler.iter("Tab")] == ["contact", "pose"]
    for splitter in plotjuggler.iter("DockSplitter"):
        count = int(splitter.get("count"))
        assert count == len(splitter) == len(splitter.get("sizes").split(";"))
    curves = [curve.get("name") for curve in plotjuggler.iter("curve")]
    assert len(curves) == len(set(curves)) > 30
    for curve in curves:
        topic = max((name for name in KINDS if curve.startswith(name + "/")), key=len)
        field = curve.removeprefix(topic + "/")
        names = {
            "/cable_tensions": [f"{name}/effort" for name in ARM.cable_names],
            "/joint_states": [f"{name}/position" for name in ARM.joint_names],
            "/joint_commands": [f"{name}/position" for name in ARM.joint_names],
            "/estimator/contact_probabilities": [f"data[{i}]" for i in range(5)],
        }.get(topic, [f"wrench/force/{axis}" for axis in "xyz"])
        assert field in names, curve
