"""The estimator, a source of tensions, and the optional nodes.

`demo.launch.py` is this file with other defaults.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory, get_packages_with_prefixes
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import matches_action
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from lifecycle_msgs.msg import Transition

from cablesense_sim.arm import open_arm
from cablesense_sim.urdf import urdf_xml

PACKAGE = "cablesense_ros"
SWITCH = ("true", "false")
EMULATED_BIT_S = 1_000_000
"""Bit rate of the emulated bus: the fastest of classical CAN."""
ARGUMENTS = {
    # name: default, choices, description
    "source": (
        "sim",
        ("sim", "can", "emulated_can"),
        "where cable_tensions come from: the sim, a CAN bus, or the sim through one",
    ),
    "arm": ("cdsm", None, "arm file: the name of a bundled one, or a path"),
    "model": ("", None, "model file: the name of a bundled one, or a path; empty: the arm's own"),
    "params_file": ("", None, "parameters of the nodes, YAML; arguments take precedence"),
    "auto_tare": ("true", SWITCH, "the first readings of the unloaded arm are its tare"),
    "calibration_file": ("", None, "calibration file of this very arm, for the estimator"),
    "respawn": ("false", SWITCH, "a node that ends is started again, and activates itself"),
    "map": ("twelve_channel_amplifier", None, "channel map: the name of a bundled one, or a path"),
    "sensor_calibration_file": (
        "",
        None,
        "scales and zeros of the tension sensors, as cablesense sensors calibrate writes them",
    ),
    "interface": ("socketcan", None, "python-can's name of the adapter's kind"),
    "channel": ("can0", None, "what that kind calls its channels"),
    "bitrate_bit_s": ("0", None, "bit rate of the bus, bit/s; 0 where the system sets it"),
    "breathe": (
        "none",
        ("none", "on_request", "continuous"),
        "the breather: a breath on ~/breathe, or all the time",
    ),
    "commission_to": (
        "",
        None,
        "the commissioner, and the file that its calibration is written to",
    ),
    "description": ("true", SWITCH, "robot_state_publisher: robot_description and tf"),
    "page": ("false", SWITCH, "the page in the browser"),
    "rviz": ("false", SWITCH, "rviz2"),
    "namespace": ("", None, "of all nodes; two arms have two"),
    "frame_prefix": ("", None, "goes before every frame name; two arms have two"),
}
BUS = ("interface", "channel", "bitrate_bit_s", "sensor_calibration_file")
SOURCES = {**dict.fromkeys(BUS, ("can",)), "map": ("can", "emulated_can")}
"""With which sources an argument has an effect, where not with all."""
OTHER_PACKAGES = {"description": "robot_state_publisher", "rviz": "rviz2"}
"""Packages that an argument starts, and that may not be installed."""


def generate_launch_description() -> LaunchDescription:
    """What to start, and when."""
    arguments = []
    for name, (default, choices, text) in ARGUMENTS.items():
        where = f"with source:={' or '.join(SOURCES[name])}: " if name in SOURCES else ""
        allowed = None if choices is None else list(choices)
        arguments.append(
            DeclareLaunchArgument(
                name, default_value=default, choices=allowed, description=where + text
            )
        )
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list:
    """The nodes for the arguments given, in their order of start."""
    arguments = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    refuse_what_has_no_effect(arguments)
    changed = {n: as_text(v) for n, v in arguments.items() if v != ARGUMENTS[n][0]}
    wanted = {name for name, value in arguments.items() if value == "true"}
    refuse_missing_packages(wanted)
    settings = Path(get_package_share_directory(PACKAGE)) / "config" / "nodes"
    respawn = "respawn" in wanted
    again = {"respawn": True, "respawn_delay": 1.0} if respawn else {}
    shared = {"arm": as_text(arguments["arm"])}
    framed = shared | {n: v for n, v in changed.items() if n == "frame_prefix"}

    def node(name: str, parameters: dict, kind: type = Node, **more: object) -> Node:
        files = (settings / f"{name}.yaml", Path(arguments["params_file"]))
        return kind(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=arguments["namespace"],
            output="screen",
            parameters=[*(str(file) for file in files if file.is_file()), parameters],
            **again,
            **more,
        )

    def lifecycle(name: str, parameters: dict) -> list:
        """Configured, then activated; one that cannot be ends the launch with an error."""
        if respawn:
            return [node(name, parameters | {"autostart": True})]
        lifecycle_node = node(name, parameters | {"autostart": False}, LifecycleNode)
        activate = change(lifecycle_node, Transition.TRANSITION_ACTIVATE)
        # the handlers stand before the event that sets them off
        return [
            *(
                RegisterEventHandler(
                    OnStateTransition(
                        target_lifecycle_node=lifecycle_node,
                        start_state=start,
                        goal_state=goal,
                        entities=[action],
                    )
                )
                for start, goal, action in (
                    ("configuring", "inactive", activate),
                    ("configuring", "unconfigured", failure(f"{name} cannot be configured")),
                    ("activating", "inactive", failure(f"{name} cannot be activated")),
                )
            ),
            lifecycle_node,
            change(lifecycle_node, Transition.TRANSITION_CONFIGURE),
        ]

    def some(*names: str) -> dict:
        return {name: changed[name] for name in names if name in changed}

    source = arguments["source"]
    breathe = arguments["breathe"]
    started: list = [] if respawn else [RegisterEventHandler(OnProcessExit(on_exit=on_exit))]
    if source != "can":
        remappings = [("cable_tensions", "simulated_tensions")] * (source != "sim")
        described = {"description": "description" not in wanted}
        started.append(node("sim", framed | described, remappings=remappings))
    bus = some("map", "sensor_calibration_file", "interface", "channel")
    if "bitrate_bit_s" in changed:
        bus["bitrate_bit_s"] = int(arguments["bitrate_bit_s"])
    if source == "emulated_can":
        suffix = arguments["namespace"].strip("/").replace("/", "_")
        adapter = {"channel": "_".join(filter(None, ["/tmp/cablesense_can", suffix]))}
        started.append(node("can_emulator", shared | bus | adapter))
        bus |= adapter | {"interface": "slcan", "bitrate_bit_s": EMULATED_BIT_S}
        bus["joint_states"] = False
    if source != "sim":
        started += lifecycle("can_driver", framed | bus)
    if breathe != "none":
        started.append(node("breather", shared | {"continuous": breathe == "continuous"}))
    if arguments["commission_to"]:
        written = {"calibration_file": as_text(arguments["commission_to"])}
        started.append(node("commissioner", shared | some("model") | written))
    tared = {"await_breath": True} if breathe != "none" else {}
    if "auto_tare" not in wanted:
        tared["auto_tare"] = False
    started += lifecycle("estimator", framed | some("model", "calibration_file") | tared)
    if "page" in wanted:
        started.append(node("page", framed))
    if "description" in wanted:
        urdf = {"robot_description": as_text(urdf_xml(open_arm(arguments["arm"])))}
        started.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=arguments["namespace"],
                parameters=[urdf | some("frame_prefix")],
                **again,
            )
        )
    if "rviz" in wanted:
        layout = settings.parent / "layouts" / "cablesense.rviz"
        seen = ("/robot_description", "/estimator/markers", "/estimator/wrench")
        started.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=arguments["namespace"],
                arguments=["-d", str(layout)],
                remappings=[(topic, topic[1:]) for topic in seen],
            )
        )
    return started


def refuse_what_has_no_effect(given: dict[str, str]) -> None:
    """Raise for an argument that would change nothing."""
    source = given["source"]
    for name, sources in SOURCES.items():
        if source not in sources and given[name] != ARGUMENTS[name][0]:
            raise RuntimeError(
                f"{name} has no effect with source:={source}; it goes with {' or '.join(sources)}"
            )
    if given["params_file"] and not Path(given["params_file"]).is_file():
        raise RuntimeError(f"params_file: there is no file {given['params_file']}")


def refuse_missing_packages(wanted: set[str]) -> None:
    """Raise before anything starts: launch itself would after other nodes have."""
    installed = get_packages_with_prefixes()
    for name, package in OTHER_PACKAGES.items():
        if name in wanted and package not in installed:
            raise RuntimeError(
                f"{package} is not installed: apt-get install "
                f"ros-$ROS_DISTRO-{package.replace('_', '-')}, or give {name}:=false"
            )


def on_exit(event: ProcessExited, _: LaunchContext) -> list[OpaqueFunction]:
    """End the launch where a node cannot start; one that ends later leaves the others."""
    return [failure(f"{event.process_name} cannot start")] if event.returncode == 2 else []


def failure(reason: str) -> OpaqueFunction:
    """Ends the launch with an error, which no event of launch does."""

    def fail(_: LaunchContext) -> None:
        raise RuntimeError(f"{reason}; see its log above")

    return OpaqueFunction(function=fail)


def as_text(value: str) -> ParameterValue:
    """As text, whatever it looks like: an empty one is no null, an arm named 1 no number."""
    return ParameterValue(value, value_type=str)


def change(node: LifecycleNode, transition: int) -> EmitEvent:
    """An event that sends a lifecycle node through a transition."""
    return EmitEvent(
        event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
    )
