"""The estimator, brought up by its lifecycle, and a source of tensions: simulation or CAN bus."""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.events import matches_action
from launch.substitutions import (
    EqualsSubstitution,
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from lifecycle_msgs.msg import Transition

PACKAGE = "cablesense_ros"
EMULATED_ADAPTER = "/tmp/cablesense_can"
ARGUMENTS = (
    # name, default, choices, description
    (
        "source",
        "sim",
        ["sim", "can", "emulated_can"],
        "where cable_tensions come from: the sim, a CAN bus, or the sim through an emulated one",
    ),
    ("arm", "cdsm", None, "arm file: the name of a bundled one, or a path"),
    ("model", "", None, "model file: the name of a bundled one, or a path; empty: the arm's own"),
    (
        "map",
        "twelve_channel_amplifier",
        None,
        "with source:=can: channel map, the name of a bundled one or the path of a .yaml file",
    ),
    ("calibration", "", None, "with source:=can: path of a calibration file, or empty for none"),
    ("interface", "socketcan", None, "with source:=can: python-can's name of the adapter's kind"),
    ("channel", "can0", None, "with source:=can: what that kind calls its channels"),
    ("state_file", "", None, "keeps the estimator's tare and command over a kill; empty: nothing"),
    (
        "breathe",
        "none",
        ["none", "on_request", "continuous"],
        "start the breather, whose ~/breathe asks for a breath, or which breathes all the time",
    ),
    ("namespace", "", None, "namespace of all nodes"),
)


def generate_launch_description() -> LaunchDescription:
    """What to start, and when."""
    settings = PathJoinSubstitution([get_package_share_directory(PACKAGE), "config", "nodes"])
    arm, model = _text("arm"), _text("model")
    bus = {name: _text(name) for name in ("map", "calibration", "interface", "channel")}
    namespace = LaunchConfiguration("namespace")
    breathes = NotEqualsSubstitution(LaunchConfiguration("breathe"), "none")
    estimator = LifecycleNode(
        package=PACKAGE,
        executable="estimator",
        name="estimator",
        namespace=namespace,
        output="screen",
        parameters=[
            PathJoinSubstitution([settings, "estimator.yaml"]),
            {"arm": arm, "model": model, "state_file": _text("state_file"), "autostart": False},
            {"await_breath": ParameterValue(breathes, value_type=bool)},
        ],
    )
    breather = Node(
        package=PACKAGE,
        executable="breather",
        name="breather",
        namespace=namespace,
        output="screen",
        parameters=[
            PathJoinSubstitution([settings, "breather.yaml"]),
            {
                "arm": arm,
                "continuous": ParameterValue(
                    EqualsSubstitution(LaunchConfiguration("breathe"), "continuous"),
                    value_type=bool,
                ),
            },
        ],
        condition=IfCondition(breathes),
    )
    simulation = [PathJoinSubstitution([settings, "sim.yaml"]), {"arm": arm}]
    driver = [PathJoinSubstitution([settings, "can_driver.yaml"]), {"arm": arm, "map": bus["map"]}]
    sources = [
        Node(
            package=PACKAGE,
            executable=executable,
            name=executable,
            namespace=namespace,
            output="screen",
            parameters=parameters,
            remappings=remappings,
            condition=IfCondition(EqualsSubstitution(LaunchConfiguration("source"), source)),
        )
        for source, executable, parameters, remappings in (
            ("sim", "sim", simulation, []),
            ("can", "can_driver", [*driver, bus], []),
            ("emulated_can", "sim", simulation, [("cable_tensions", "simulated_tensions")]),
            (
                "emulated_can",
                "can_emulator",
                [{"arm": arm, "map": bus["map"], "channel": EMULATED_ADAPTER}],
                [],
            ),
            (
                "emulated_can",
                "can_driver",
                [
                    *driver,
                    {
                        "interface": "slcan",
                        "channel": EMULATED_ADAPTER,
                        "bitrate_bit_s": 1_000_000,
                    },
                ],
                [],
            ),
        )
    ]
    activate_when_configured = RegisterEventHandler(
        OnStateTransition(
            target_lifecycle_node=estimator,
            start_state="configuring",
            goal_state="inactive",
            entities=[_change(estimator, Transition.TRANSITION_ACTIVATE)],
        )
    )
    configure = _change(estimator, Transition.TRANSITION_CONFIGURE)
    arguments = [
        DeclareLaunchArgument(name, default_value=default, choices=choices, description=text)
        for name, default, choices, text in ARGUMENTS
    ]
    # the handler stands before the event that sets it off
    return LaunchDescription(
        [*arguments, *sources, breather, estimator, activate_when_configured, configure]
    )


def _text(argument: str) -> ParameterValue:
    """As text, whatever it looks like: an empty argument is no null, an arm named 1 no number."""
    return ParameterValue(LaunchConfiguration(argument), value_type=str)


def _change(node: LifecycleNode, transition: int) -> EmitEvent:
    return EmitEvent(
        event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
    )
