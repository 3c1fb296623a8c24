"""Layouts for RViz, Foxglove and PlotJuggler: well formed, and every topic is of the contract."""

import json
import xml.etree.ElementTree as ET

import yaml

from cablesense_base.installation import config_path
from cablesense_msgs_py.qos import CONTRACT, resolved
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
KINDS = {resolved(topic): of.kind for topic, of in CONTRACT.items()}


def text_of(name):
    return config_path(f"layouts/cablesense{name}").read_text(encoding="utf-8")


def test_rviz_shows_the_arm_and_the_contact():
    manager = yaml.safe_load(text_of(".rviz"))["Visualization Manager"]
    shown = {}
    for display in manager["Displays"]:
        topic = display.get("Description Topic") or display.get("Topic")
        if topic:
            shown[display["Class"].partition("/")[2]] = KINDS[topic["Value"]].rpartition("/")[2]
    kinds = {"RobotModel": "String", "MarkerArray": "MarkerArray", "Wrench": "WrenchStamped"}
    assert shown == kinds
    assert manager["Global Options"]["Fixed Frame"] == "base_link"


def test_foxglove_panels_are_placed_once_and_read_topics_that_exist():
    layout = json.loads(text_of("_foxglove.json"))
    panels = layout["configById"]
    assert sorted(placed(layout["layout"])) == sorted(panels)
    for name, panel in panels.items():
        read = [path["value"].partition(".")[0] for path in panel.get("paths", [])]
        assert set(read) <= set(KINDS), name
    scene = panels["3D!arm"]
    layer = scene["layers"]["arm"]
    others = {layer["topic"], layer["jointStatesTopic"], panels["RawMessages!wrench"]["topicPath"]}
    assert {*scene["topics"], *others} <= set(KINDS)
    health = panels["DiagnosticSummary!health"]["topicToRender"]
    assert KINDS[health] == "diagnostic_msgs/msg/DiagnosticArray"


def placed(node):
    if isinstance(node, str):
        return [node]
    return placed(node["first"]) + placed(node["second"])


def test_plotjuggler_curves_are_series_of_the_contract():
    curves = [
        curve.get("name") for curve in ET.fromstring(text_of("_plotjuggler.xml")).iter("curve")
    ]
    assert len(curves) == len(set(curves)) > 30
    fields = {
        "/cable_tensions": [f"{name}/effort" for name in ARM.cable_names],
        "/joint_states": [f"{name}/position" for name in ARM.joint_names],
        "/joint_commands": [f"{name}/position" for name in ARM.joint_names],
        "/estimator/contact_probabilities": [f"data[{i}]" for i in range(5)],
    }
    for curve in curves:
        topic = max((name for name in KINDS if curve.startswith(name + "/")), key=len)
        forces = [f"wrench/force/{axis}" for axis in "xyz"]
        assert curve.removeprefix(topic + "/") in fields.get(topic, forces), curve
