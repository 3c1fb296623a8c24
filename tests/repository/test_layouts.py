"""Layouts for RViz, Foxglove and PlotJuggler, as far as they can be checked without the programs.

They have the parts that the programs write; topics, fields and frames are of the contract; and
what they subscribe to is offered with the quality that they ask for.
"""

import json
import re
import xml.etree.ElementTree as ET

import pytest
import yaml

from cablesense_base.installation import config_path
from cablesense_msgs_py.qos import RECORDED_TOPICS, resolved
from cablesense_msgs_py.topics import Frames
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
RECORDED = {resolved(topic): of for topic, of in RECORDED_TOPICS.items()}
LENGTHS = {
    "/cable_tensions": ARM.cable_count,
    "/joint_states": ARM.joint_count,
    "/joint_commands": ARM.joint_count,
    "/estimator/contact_probabilities": ARM.segment_count + 1,
}
"""Elements of the lists in messages of the arm for which the layouts are."""
NUMBERS = ("double", "float", "int32")
FRAMES = Frames(ARM.segment_count)


def text_of(name):
    return config_path(f"layouts/cablesense{name}").read_text(encoding="utf-8")


def fields_of(topic):
    """Names and types of the fields of a topic's message, and whether it has a stamp."""
    endpoints = pytest.importorskip("cablesense_ros.endpoints")
    return endpoints.message_class(RECORDED[topic].kind).get_fields_and_field_types()


def is_number(topic, path):
    """Whether a path of fields, such as `wrench.force.y` or `effort[0]`, leads to a number."""
    endpoints = pytest.importorskip("cablesense_ros.endpoints")
    fields = fields_of(topic)
    kind = ""
    for step in path.split("."):
        name, _, index = step.rstrip("]").partition("[")
        kind = fields[name]
        if index:
            assert int(index) < LENGTHS[topic], path
            kind = re.fullmatch(r"sequence<(.*)>", kind)[1]
        if "/" in kind:
            message = endpoints.message_class(kind.replace("/", "/msg/"))
            fields = message.get_fields_and_field_types()
    return kind in NUMBERS


def test_rviz_shows_the_arm_and_the_contact():
    manager = yaml.safe_load(text_of(".rviz"))["Visualization Manager"]
    shown = {}
    for display in manager["Displays"]:
        topic = display.get("Description Topic") or display.get("Topic")
        if topic:
            kind = RECORDED[topic["Value"]].kind
            shown[display["Class"].partition("/")[2]] = kind.rpartition("/")[2]
    kinds = {"RobotModel": "String", "MarkerArray": "MarkerArray", "Wrench": "WrenchStamped"}
    assert shown == kinds
    assert manager["Global Options"]["Fixed Frame"] == FRAMES.base


def test_rviz_asks_for_a_quality_that_is_offered():
    """A reliable reader hears no best-effort writer, a transient-local one no volatile writer."""
    manager = yaml.safe_load(text_of(".rviz"))["Visualization Manager"]
    topics = [d.get("Description Topic") or d.get("Topic") for d in manager["Displays"]]
    for topic in filter(None, topics):
        offered = RECORDED[topic["Value"]].offered
        assert offered.reliable or topic["Reliability Policy"] == "Best Effort"
        assert offered.transient_local or topic["Durability Policy"] == "Volatile"
        assert topic["History Policy"] == "Keep Last"
        assert topic["Depth"] >= 1


def test_foxglove_panels_are_placed_once_and_read_topics_that_exist():
    layout = json.loads(text_of("_foxglove.json"))
    parts = {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert set(layout) == parts
    panels = layout["configById"]
    assert sorted(placed(layout["layout"])) == sorted(panels)
    kinds = {name.partition("!")[0] for name in panels}
    assert kinds == {"3D", "Plot", "DiagnosticSummary", "RawMessages"}
    scene = panels["3D!arm"]
    layer = scene["layers"]["arm"]
    others = {layer["topic"], layer["jointStatesTopic"], panels["RawMessages!wrench"]["topicPath"]}
    assert {*scene["topics"], *others} <= set(RECORDED)
    assert scene["followTf"] == scene["layers"]["grid"]["frameId"] == FRAMES.base
    health = panels["DiagnosticSummary!health"]["topicToRender"]
    assert RECORDED[health].kind == "diagnostic_msgs/msg/DiagnosticArray"


def test_foxglove_plots_numbers_by_the_stamps_that_there_are():
    panels = json.loads(text_of("_foxglove.json"))["configById"]
    series = [path for panel in panels.values() for path in panel.get("paths", [])]
    assert len(series) > 20
    for path in series:
        topic, _, fields = path["value"].partition(".")
        assert is_number(topic, fields), path["value"]
        stamped = "header" in fields_of(topic)
        assert path["timestampMethod"] == ("headerStamp" if stamped else "receiveTime")


def placed(node):
    """Panels in a tree of two parts each."""
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return placed(node["first"]) + placed(node["second"])


def test_plotjuggler_docks_have_the_parts_and_sizes_that_they_state():
    root = ET.fromstring(text_of("_plotjuggler.xml"))
    tabs = root.findall("tabbed_widget/Tab")
    index = root.find("tabbed_widget/currentTabIndex").get("index")
    assert int(index) < len(tabs)
    for tab in tabs:
        assert int(tab.get("containers")) == len(tab.findall("Container"))
    for splitter in root.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.get("sizes").split(";")]
        assert len(splitter) == len(sizes) == int(splitter.get("count"))
        assert sum(sizes) == pytest.approx(1.0)
        assert splitter.get("orientation") in ("-", "|")
        assert {part.tag for part in splitter} <= {"DockArea", "DockSplitter"}
    for area in root.iter("DockArea"):
        (plot,) = area.findall("plot")
        assert plot.get("mode") == "TimeSeries"


def test_plotjuggler_curves_are_numbers_of_the_contract():
    """It names the elements of a `JointState` after its cables or joints."""
    curves = [
        curve.get("name") for curve in ET.fromstring(text_of("_plotjuggler.xml")).iter("curve")
    ]
    assert len(curves) == len(set(curves)) > 30
    for curve in curves:
        topic = max((name for name in RECORDED if curve.startswith(f"{name}/")), key=len)
        fields = curve.removeprefix(f"{topic}/").replace("/", ".")
        if RECORDED[topic].kind == "sensor_msgs/msg/JointState":
            element, _, field = fields.partition(".")
            names = ARM.cable_names if topic == "/cable_tensions" else ARM.joint_names
            assert element in names, curve
            fields = f"{field}[{names.index(element)}]"
        assert is_number(topic, fields), curve
