"""Topics of a recording by their full names, in any namespace, with types that exist."""

import pytest

from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import INPUTS, RECORDED_TOPICS, recorded_topic, resolved


@pytest.mark.parametrize("namespace", ["", "/", "left", "/lab/left/"])
@pytest.mark.parametrize("topic", RECORDED_TOPICS)
def test_a_name_is_resolved_and_told_again(topic, namespace):
    name = resolved(topic, namespace)
    assert name.startswith("/")
    assert "//" not in name
    assert "~" not in name
    assert recorded_topic(name.format(2)) == topic


def test_names_as_ros_resolves_them():
    assert resolved(topics.WRENCH) == "/estimator/wrench"
    assert resolved(topics.WRENCH, "/lab/left") == "/lab/left/estimator/wrench"
    assert resolved(topics.CABLE_TENSIONS, "lab") == "/lab/cable_tensions"
    assert resolved(topics.DIAGNOSTICS, "lab") == "/diagnostics"


@pytest.mark.parametrize("name", ["/rosout", "/wrench", "/other/wrench", "/", "", "cable"])
def test_other_topics_are_none_of_it(name):
    assert recorded_topic(name) is None


def test_types_are_installed_or_left_out():
    from cablesense_ros.endpoints import message_class

    missing = {of.kind for of in RECORDED_TOPICS.values() if message_class(of.kind) is None}
    assert missing <= {"tf2_msgs/msg/TFMessage"}
    assert message_class("sensor_msgs/msg/JointState").__name__ == "JointState"
    assert message_class("no_such_msgs/msg/Thing") is None
    assert set(INPUTS) < set(RECORDED_TOPICS)
