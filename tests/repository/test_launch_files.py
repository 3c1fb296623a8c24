"""The launch files, described to a stand-in of the launch API (the real one comes with ROS)."""

import sys
from types import ModuleType, SimpleNamespace

import pytest

from tests.helpers.checkout import CHECKOUT

FOLDER = CHECKOUT / "cablesense_ros" / "launch"
MODULES = {
    "launch": ["LaunchContext", "LaunchDescription"],
    "launch.actions": [
        "DeclareLaunchArgument",
        "EmitEvent",
        "IncludeLaunchDescription",
        "OpaqueFunction",
        "RegisterEventHandler",
    ],
    "launch.event_handlers": ["OnProcessExit"],
    "launch.events": ["matches_action"],
    "launch.events.process": ["ProcessExited"],
    "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
    "launch.substitutions": ["LaunchConfiguration"],
    "launch_ros": [],
    "launch_ros.actions": ["LifecycleNode", "Node"],
    "launch_ros.event_handlers": ["OnStateTransition"],
    "launch_ros.events": [],
    "launch_ros.events.lifecycle": ["ChangeState"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
    "ament_index_python.packages": [],
}
NODES = ("Node", "LifecycleNode")


class Described:
    """Anything of the launch API: its kind and what it was given."""

    def __init__(self, kind, args, given):
        self.kind = kind
        self.args = args
        self.given = given

    def perform(self, context):
        return context[self.args[0]]

    def parameter(self, name):
        """A parameter as the node gets it, whichever of the files and mappings has it last."""
        value = None
        for mapping in self.given["parameters"]:
            if isinstance(mapping, dict):
                value = mapping.get(name, value)
        return value.args[0] if isinstance(value, Described) else value


@pytest.fixture
def missing():
    """Names of packages that are not installed."""
    return set()


@pytest.fixture
def describe(monkeypatch, missing):
    pytest.importorskip("lifecycle_msgs.msg")
    for name, classes in MODULES.items():
        module = ModuleType(name)
        for kind in classes:
            setattr(module, kind, lambda *args, _kind=kind, **given: Described(_kind, args, given))
        monkeypatch.setitem(sys.modules, name, module)
    packages = sys.modules["ament_index_python.packages"]
    packages.get_package_share_directory = lambda name: str(FOLDER.parents[1])
    packages.get_packages_with_prefixes = lambda: {"robot_state_publisher", "rviz2"} - missing

    def load(file):
        code = compile((FOLDER / file).read_text(), file, "exec")
        scope = {"__name__": "launch_file"}
        exec(code, scope)
        return list(scope["generate_launch_description"]().args[0])

    return load


@pytest.fixture
def start(describe):
    """What is started with some arguments, by the including file's defaults."""

    def started(file="estimator.launch.py", **given):
        declared = describe(file)
        if file != "estimator.launch.py":
            assert of_kind(declared, "IncludeLaunchDescription")
            declared += describe("estimator.launch.py")
        context = {}
        for argument in of_kind(declared, "DeclareLaunchArgument"):
            context.setdefault(argument.args[0], argument.given["default_value"])
        assert set(given) <= set(context)
        (function,) = of_kind(declared, "OpaqueFunction")
        return function.given["function"](context | given)

    return started


def of_kind(entities, *kinds):
    return [entity for entity in entities if entity.kind in kinds]


def nodes(entities):
    return {node.given["executable"]: node for node in of_kind(entities, *NODES)}


def test_the_estimator_is_configured_then_activated_or_the_launch_ends(start):
    transitions = pytest.importorskip("lifecycle_msgs.msg").Transition
    entities = start()
    (node,) = of_kind(entities, "LifecycleNode")
    assert node.given["executable"] == "estimator"
    assert node.parameter("autostart") is False
    handlers = [handler.args[0] for handler in of_kind(entities, "RegisterEventHandler")]
    (at_exit,) = of_kind(handlers, "OnProcessExit")
    steps = [handler.given for handler in of_kind(handlers, "OnStateTransition")]
    assert all(step["target_lifecycle_node"] is node for step in steps)
    then = {(step["start_state"], step["goal_state"]): step["entities"][0] for step in steps}
    activate = then.pop(("configuring", "inactive")).given["event"]
    assert activate.given["transition_id"] == transitions.TRANSITION_ACTIVATE
    killed, cannot_start = (
        at_exit.given["on_exit"](SimpleNamespace(returncode=code, process_name="sim-1"), None)
        for code in (-9, 2)
    )
    assert not killed
    assert set(then) == {("configuring", "unconfigured"), ("activating", "inactive")}
    for end in (*then.values(), *cannot_start):
        with pytest.raises(RuntimeError, match="cannot"):
            end.given["function"](None)
    (configure,) = of_kind(entities, "EmitEvent")
    assert configure.given["event"].given["transition_id"] == transitions.TRANSITION_CONFIGURE
    assert entities.index(configure) == len(entities) - 2  # before robot_state_publisher


def test_a_respawned_node_activates_itself(start):
    entities = start(respawn="true", calibration_file="/tmp/known.npz")
    assert not of_kind(entities, "LifecycleNode", "EmitEvent")
    estimator = nodes(entities)["estimator"]
    assert estimator.given["respawn"] is True
    assert estimator.parameter("autostart") is True
    assert estimator.parameter("calibration_file") == "/tmp/known.npz"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("sim", {"sim"}),
        ("can", {"can_driver"}),
        ("emulated_can", {"sim", "can_emulator", "can_driver"}),
    ],
)
def test_one_source_runs_by_choice_and_one_node_describes_the_arm(start, source, found):
    started = nodes(start(source=source))
    assert set(started) - {"estimator", "robot_state_publisher"} == found
    description = started["robot_state_publisher"].parameter("robot_description")
    assert "<robot" in description
    if "sim" in found:
        assert started["sim"].parameter("description") is False
    if found == {"sim", "can_emulator", "can_driver"}:
        assert started["can_driver"].parameter("joint_states") is False


def test_an_emulated_bus_of_its_own_stands_between_sim_and_driver(start):
    links = set()
    for namespace in ("", "left"):
        started = nodes(start(source="emulated_can", namespace=namespace))
        assert started["sim"].given["remappings"] == [("cable_tensions", "simulated_tensions")]
        driver, emulator = (started[name] for name in ("can_driver", "can_emulator"))
        assert driver.parameter("channel") == emulator.parameter("channel")
        assert driver.parameter("interface") == "slcan"
        links.add(driver.parameter("channel"))
    assert len(links) == 2


def test_arguments_reach_the_node_that_they_are_of(start, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("/**:\n  ros__parameters: {tare_samples: 7}\n")
    bus = {"interface": "slcan", "channel": "/dev/ttyACM0", "bitrate_bit_s": "500000"}
    started = nodes(
        start(source="can", params_file=str(file), auto_tare="false", model="mine.onnx", **bus)
    )
    driver = started["can_driver"]
    estimator = started["estimator"]
    assert {name: str(driver.parameter(name)) for name in bus} == bus
    assert estimator.parameter("auto_tare") is False
    assert estimator.parameter("model") == "mine.onnx"
    assert str(file) in estimator.given["parameters"]


def test_a_commissioner_is_started_with_the_file_that_it_writes(start):
    assert "commissioner" not in nodes(start())
    commissioner = nodes(start(commission_to="1.calibration", model="mine.onnx"))["commissioner"]
    assert commissioner.parameter("calibration_file") == "1.calibration"
    assert commissioner.parameter("model") == "mine.onnx"


def test_the_demo_is_the_estimator_with_the_page(start):
    plain = set(nodes(start(breathe="continuous")))
    started = nodes(start("demo.launch.py", namespace="left", frame_prefix="left_"))
    assert set(started) ^ plain == {"page", "breather"}
    assert {node.given["namespace"] for node in started.values()} == {"left"}
    assert {node.parameter("frame_prefix") for node in started.values()} == {"left_"}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"channel": "can1"}, "channel has no effect with source:=sim"),
        ({"params_file": "/nowhere.yaml"}, "there is no file /nowhere.yaml"),
    ],
)
def test_what_has_no_effect_is_refused(start, given, told):
    with pytest.raises(RuntimeError, match=told):
        start(**given)


@pytest.mark.parametrize(
    ("argument", "package"), [("description", "robot_state_publisher"), ("rviz", "rviz2")]
)
def test_a_missing_package_is_told_before_anything_starts(start, missing, argument, package):
    missing.add(package)
    with pytest.raises(RuntimeError, match=f"{package} is not installed.*{argument}:=false"):
        start(**{argument: "true"})
    assert start(**{argument: "false"})


@pytest.mark.parametrize(
    ("file", "default"),
    [
        ("sim.yaml", True),
        ("estimator.yaml", True),
        ("force_torque_sensor.yaml", False),
        ("can_driver.yaml", True),
        ("breather.yaml", True),
        ("commissioner.yaml", True),
    ],
)
def test_node_settings_name_parameters_that_exist(file, default):
    yaml = pytest.importorskip("yaml")
    pytest.importorskip("rclpy")
    from cablesense_ros.node_process import parameter_table

    content = yaml.safe_load((FOLDER.parents[1] / "config" / "nodes" / file).read_text())
    ((node, settings),) = content.items()
    known = {parameter.name: parameter for parameter in parameter_table(node.removeprefix("/**/"))}
    for name, value in settings["ros__parameters"].items():
        assert known[name].allows(value)
        assert type(value) is type(known[name].default)
        assert (value == known[name].default) is default
