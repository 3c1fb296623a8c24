"""The launch files, described to a stand-in of the launch API (the real one comes with ROS)."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).parents[2] / "cablesense_ros" / "launch"
MODULES = {
    "launch": ["LaunchContext", "LaunchDescription"],
    "launch.actions": [
        "DeclareLaunchArgument",
        "EmitEvent",
        "IncludeLaunchDescription",
        "OpaqueFunction",
        "RegisterEventHandler",
    ],
    "launch.conditions": ["IfCondition"],
    "launch.events": ["matches_action"],
    "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
    "launch.substitutions": [
        "EqualsSubstitution",
        "LaunchConfiguration",
        "NotEqualsSubstitution",
        "PathJoinSubstitution",
    ],
    "launch_ros": [],
    "launch_ros.actions": ["LifecycleNode", "Node"],
    "launch_ros.event_handlers": ["OnStateTransition"],
    "launch_ros.events": [],
    "launch_ros.events.lifecycle": ["ChangeState"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
    "ament_index_python.packages": [],
}


class Described:
    """Anything of the launch API: its kind and what it was given."""

    def __init__(self, kind, args, given):
        self.kind, self.args, self.given = kind, args, given

    def perform(self, context):
        return context[self.args[0]]


@pytest.fixture
def describe(monkeypatch):
    for name, classes in MODULES.items():
        module = ModuleType(name)
        for kind in classes:
            setattr(module, kind, lambda *args, _kind=kind, **given: Described(_kind, args, given))
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules["ament_index_python.packages"].get_package_share_directory = lambda name: "/share"

    def load(file):
        code = compile((FOLDER / file).read_text(), file, "exec")
        scope = {"__name__": "launch_file"}
        exec(code, scope)
        return list(scope["generate_launch_description"]().args[0])

    return load


def of_kind(entities, kind):
    return [entity for entity in entities if entity.kind == kind]


def test_the_estimator_is_configured_then_activated(describe):
    transitions = pytest.importorskip("lifecycle_msgs.msg").Transition
    entities = describe("estimator.launch.py")
    (node,) = of_kind(entities, "LifecycleNode")
    assert node.given["executable"] == "estimator"
    assert node.given["parameters"][1]["autostart"] is False
    (handler,) = of_kind(entities, "RegisterEventHandler")
    transition = handler.args[0]
    assert transition.given["target_lifecycle_node"] is node
    assert transition.given["goal_state"] == "inactive"
    (activate,) = transition.given["entities"]
    (configure,) = of_kind(entities, "EmitEvent")
    wanted = [event.given["event"].given["transition_id"] for event in (configure, activate)]
    assert wanted == [transitions.TRANSITION_CONFIGURE, transitions.TRANSITION_ACTIVATE]
    assert entities.index(handler) < entities.index(configure)


def nodes_by_source(entities):
    found = {}
    for node in of_kind(entities, "Node"):
        if node.given["executable"] == "breather":
            continue
        source = node.given["condition"].args[0].args[1]
        found.setdefault(source, {})[node.given["executable"]] = node
    return found


def test_one_source_runs_by_choice(describe):
    entities = describe("estimator.launch.py")
    source = next(e for e in of_kind(entities, "DeclareLaunchArgument") if e.args[0] == "source")
    found = nodes_by_source(entities)
    assert source.given["choices"] == list(found) == ["sim", "can", "emulated_can"]
    assert {name: set(nodes) for name, nodes in found.items()} == {
        "sim": {"sim"},
        "can": {"can_driver"},
        "emulated_can": {"sim", "can_emulator", "can_driver"},
    }


def test_the_breather_runs_by_choice_and_the_tare_waits_for_it(describe):
    entities = describe("estimator.launch.py")
    (breather,) = (
        node for node in of_kind(entities, "Node") if node.given["executable"] == "breather"
    )
    (estimator,) = of_kind(entities, "LifecycleNode")
    (chosen,) = breather.given["condition"].args
    assert chosen.kind == "NotEqualsSubstitution"
    assert chosen.args[1] == "none"
    assert estimator.given["parameters"][-1]["await_breath"].args == (chosen,)


def test_an_emulated_bus_stands_between_sim_and_driver(describe):
    nodes = nodes_by_source(describe("estimator.launch.py"))["emulated_can"]
    assert nodes["sim"].given["remappings"] == [("cable_tensions", "simulated_tensions")]
    driver, emulator = (nodes[n].given["parameters"][-1] for n in ("can_driver", "can_emulator"))
    assert driver["channel"] == emulator["channel"]
    assert driver["interface"] == "slcan"


def test_the_bus_is_read_by_the_map_and_interface_given(describe):
    entities = describe("estimator.launch.py")
    declared = {e.args[0] for e in of_kind(entities, "DeclareLaunchArgument")}
    driver = nodes_by_source(entities)["can"]["can_driver"]
    given = driver.given["parameters"]
    assert "arm" in given[1]
    assert {"map", "calibration", "interface", "channel"} == set(given[2]) <= declared


def test_the_demo_includes_the_estimator_and_describes_the_arm(describe):
    entities = describe("demo.launch.py")
    (included,) = of_kind(entities, "IncludeLaunchDescription")
    assert dict(included.given["launch_arguments"])["source"] == "sim"
    (function,) = of_kind(entities, "OpaqueFunction")
    (publisher,) = function.given["function"]({"arm": "cdsm"})
    description = publisher.given["parameters"][0]["robot_description"].args[0]
    assert "<robot" in description


def test_the_controller_comes_with_the_estimator_and_a_wall(describe):
    entities = describe("admittance.launch.py")
    (included,) = of_kind(entities, "IncludeLaunchDescription")
    assert set(dict(included.given["launch_arguments"])) == {"source", "arm", "model"}
    nodes = {node.given["executable"]: node.given for node in of_kind(entities, "Node")}
    assert set(nodes) == {"admittance", "obstacle", "page"}
    assert "condition" not in nodes["admittance"]
    assert nodes["obstacle"]["condition"].args[0].args == ("obstacle",)


@pytest.mark.parametrize(
    "file",
    [
        "sim.yaml",
        "estimator.yaml",
        "can_driver.yaml",
        "admittance.yaml",
        "obstacle.yaml",
        "breather.yaml",
    ],
)
def test_node_settings_name_parameters_that_exist(file):
    yaml = pytest.importorskip("yaml")
    pytest.importorskip("rclpy")
    from cablesense_ros.parameters import parameter_table

    table = parameter_table(file.removesuffix(".yaml"))
    known = {parameter.name: parameter.default for parameter in table}
    content = yaml.safe_load((FOLDER.parents[1] / "config" / "nodes" / file).read_text())
    (node,) = content.values()
    for name, value in node["ros__parameters"].items():
        assert value == known[name]
        assert type(value) is type(known[name])
