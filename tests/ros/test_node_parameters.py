"""What all nodes share: tables of parameters, never NaN, and the log of refused messages."""

import math

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import try_shutdown

from cablesense_base import CableSenseError
from cablesense_msgs_py.topics import ContractError
from cablesense_online.state import LIVE_SETTINGS
from cablesense_ros.endpoints import RefusalLog
from cablesense_ros.parameters import (
    NodeParameter,
    ParameterError,
    declare_parameters,
    parameter_table,
)

rclpy = pytest.importorskip("rclpy")


pytestmark = [pytest.mark.ros, pytest.mark.filterwarnings("ignore::DeprecationWarning")]

RATE = NodeParameter("rate_hz", 10.0, "A rate, Hz.", (1.0, 100.0))
NODES = ["sim", "estimator", "can_driver", "can_emulator", "breather", "page"]


@pytest.fixture
def make_node():
    nodes = []

    def make(**overrides):
        rclpy.init()
        given = [Parameter(name, value=value) for name, value in overrides.items()]
        nodes.append(Node("parameters", parameter_overrides=given))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    try_shutdown()


def test_a_parameter_shows_its_description_and_range(make_node):
    node = make_node()
    assert declare_parameters(node, [RATE])["rate_hz"] == 10.0
    descriptor = node.describe_parameter("rate_hz")
    assert descriptor.description == "A rate, Hz."
    assert descriptor.floating_point_range[0].to_value == 100.0
    assert descriptor.read_only


def test_values_in_degrees_are_given_in_radians_as_well(make_node):
    speed = NodeParameter("joint_speed_deg_s", 180.0, "Speed, deg/s.")
    given = declare_parameters(make_node(), [speed, NodeParameter("degree", 2.0, "None.")])
    assert given["joint_speed_deg_s"] == 180.0
    assert given["joint_speed_rad_s"] == pytest.approx(math.pi)
    assert "radree" not in given


@pytest.mark.parametrize("value", [0.5, 1e9, math.nan, math.inf, 50, "fast", True])
def test_a_wrong_value_at_start_is_refused_with_what_would_be_right(make_node, value):
    with pytest.raises(ParameterError, match=r"rate_hz.*decimal point from 1 to 100"):
        declare_parameters(make_node(rate_hz=value), [RATE])


@pytest.mark.parametrize("value", [math.nan, math.inf, 1000.0])
def test_a_wrong_value_later_is_refused(make_node, value):
    node = make_node()
    declare_parameters(node, [RATE], configured=lambda: False)
    (result,) = node.set_parameters([Parameter("rate_hz", value=value)])
    assert not result.successful
    assert node.get_parameter("rate_hz").value == 10.0


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_of_the_nodes_is_described_and_every_number_bounded(node):
    for parameter in parameter_table(node):
        assert parameter.description.endswith(".")
        if type(parameter.default) in (int, float):
            low, high = parameter.bounds
            assert low <= parameter.default <= high
            assert type(low) is type(high) is type(parameter.default)


def test_what_is_read_once_is_refused_from_then_on_with_the_reason(make_node):
    node, configured = make_node(), []
    gain = NodeParameter("gain", 1.0, "A gain.", (0.0, 9.0), live=True)
    declare_parameters(node, [RATE, gain], configured=lambda: bool(configured))
    faster = Parameter("rate_hz", value=20.0)
    assert node.set_parameters([faster])[0].successful
    configured.append(True)
    assert node.set_parameters([faster])[0].successful  # nothing changes
    (refused,) = node.set_parameters([Parameter("rate_hz", value=30.0)])
    assert "rate_hz is read when the node is configured" in refused.reason
    assert node.set_parameters([Parameter("gain", value=2.0)])[0].successful
    told = [node.describe_parameter(name).additional_constraints for name in ("rate_hz", "gain")]
    assert told == ["read when the node is configured", "may change at any time"]


def test_settings_that_an_estimator_takes_over_while_it_runs_are_live():
    live = {parameter.name for parameter in parameter_table("estimator") if parameter.live}
    assert set(LIVE_SETTINGS) <= live


def test_a_refusal_of_one_kind_does_not_hide_another_in_the_same_second():
    class Log(list):
        get_logger = lambda self: self  # noqa: E731
        warning = list.append

    log = Log()
    refuse = RefusalLog(log)
    for topic in ("joint_commands", "applied_wrench"):
        for error in (ContractError("no name"), ContractError("no name"), CableSenseError("far")):
            refuse(topic, error)
    assert log == [
        f"{topic}: message refused: {why}"
        for topic in ("joint_commands", "applied_wrench")
        for why in ("no name", "far")
    ]
