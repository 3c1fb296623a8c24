"""`~/estimate`: its file, what the node puts into it, and the message over the real middleware."""

import math
import re
import shutil
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3, Wrench, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from cablesense_base.installation import config_path
from cablesense_msgs_py.messages import UNKNOWN_WRENCH, Contact, ForceState
from cablesense_msgs_py.topics import Frames
from cablesense_online.answer import Answer
from cablesense_online.placed_links import PlacedLinks
from cablesense_ros.estimator_outputs import put_estimate
from cablesense_sim.arm import open_arm
from tests.helpers.checkout import CHECKOUT

PACKAGE = CHECKOUT / "cablesense_msgs"
FILE = PACKAGE / "msg" / "ForceEstimate.msg"
OF_OTHERS = {"header": Header, "wrench": Wrench, "wrench_base": Wrench, "contact_point": Point}


@pytest.fixture
def described():
    """The message as ROS's own parser reads its file."""
    parser = pytest.importorskip("rosidl_adapter.parser")
    return parser.parse_message_file("cablesense_msgs", str(FILE))


def filled(described, answer):
    constants = {one.name: one.value for one in described.constants}
    nested = {name: kind() for name, kind in OF_OTHERS.items()}
    message = SimpleNamespace(**constants, **nested)
    put_estimate(message, answer, UNKNOWN_WRENCH, Frames(4), PlacedLinks(None), Time(sec=7))
    return message


def test_every_field_is_set_and_no_other(described):
    message = filled(described, Answer())
    fields = {field.name for field in described.fields}
    assert vars(message).keys() == fields | {one.name for one in described.constants}


def test_every_state_has_a_constant_and_an_empty_message_is_of_a_silent_estimator(described):
    numbers = {one.name: one.value for one in described.constants}
    assert numbers.keys() == {state.name for state in ForceState}
    assert len(set(numbers.values())) == len(numbers)
    assert numbers["SILENT"] == 0
    for state in ForceState:
        assert filled(described, Answer(force=state)).state == numbers[state.name]


def test_what_is_not_known_is_no_number(described):
    message = filled(described, Answer(force=ForceState.MOVING))
    assert (message.header.frame_id, message.header.stamp.sec) == ("base_link", 7)
    assert (message.segment, message.moment_only) == (0, False)
    point = message.contact_point
    wrench = message.wrench
    unknown = [message.force_low, message.force_high, message.place_low, message.place_high]
    unknown += [message.probability, point.x, point.y, wrench.force.x, wrench.torque.z]
    assert all(map(math.isnan, [*unknown, *message.covariance]))


def test_of_several_contacts_it_is_the_strongest(described):
    contacts = [Contact(3, 90.0, 20.0, 0.1), Contact(2, 0.0, 8.0, 0.05)]
    probabilities = [0.0, 0.1, 0.9, 0.8, 0.2]
    message = filled(described, Answer(ForceState.CONTACT, contacts, probabilities=probabilities))
    assert (message.header.frame_id, message.probability) == ("segment_3", 0.8)
    assert message.wrench.force.y == pytest.approx(20.0)
    assert message.wrench.torque.z == pytest.approx(2.0)
    assert message.contact_point.x == 0.1


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The folder of the package, made from the wheels."""
    pytest.importorskip("rosidl_generator_py", reason="needs the generators of the wheels")
    if shutil.which("gcc") is None:
        pytest.skip("no gcc on PATH: apt-get install gcc; the message is compiled with it")
    folder = tmp_path_factory.mktemp("messages")
    command = [sys.executable, PACKAGE / "compile_for_wheels.py", folder]
    subprocess.run(command, check=True, capture_output=True)
    return folder


@pytest.fixture
def estimate_class(compiled, monkeypatch):
    for name in ("cablesense_msgs", "cablesense_msgs.msg"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(compiled)
    monkeypatch.setenv("PYTHONPATH", str(compiled))
    return import_module("cablesense_msgs.msg").ForceEstimate


@pytest.mark.timeout(180)
def test_one_message_has_state_wrench_interval_and_place(graph, start, estimate_class):
    file = config_path("nodes/force_torque_sensor.yaml")
    (settings,) = yaml.safe_load(file.read_text()).values()
    estimator = start("estimator", tare_samples=20, **settings["ros__parameters"])
    start("sim")
    estimates = graph.listen(estimate_class, "/estimator/estimate")
    wrenches = graph.listen(WrenchStamped, "/estimator/wrench")
    sensor = graph.listen(WrenchStamped, "/estimator/wrench_base")
    graph.until(lambda: "tare taken" in estimator.log, "the tare")

    def is_last(state):
        number = getattr(estimate_class, state)
        return lambda: bool(estimates) and estimates[-1].state == number

    def of_sample(messages, estimate):
        stamp = estimate.header.stamp
        of_stamp = lambda: [one for one in messages[-99:] if one.header.stamp == stamp]  # noqa: E731
        graph.until(of_stamp, "the message of a sample")
        return of_stamp()[0]

    def pushed(segment, state):
        """An estimate of 40 N in this state; other topics say the same of its sample."""
        graph.push(segment, (0.0, 36.0, 17.4))  # normal to no cable of segment 1
        graph.until(
            lambda: (
                is_last(state)()
                and estimates[-1].force_low < 41.0
                and estimates[-1].force_high > 39.0
            ),
            f"{state} on segment {segment}",
        )
        estimate = estimates[-1]
        assert estimate.segment == segment
        assert estimate.wrench == of_sample(wrenches, estimate).wrench
        in_base = of_sample(sensor, estimate)
        assert in_base.header.frame_id == "base_link"
        assert str(in_base.wrench) == str(estimate.wrench_base)  # also where it is no number
        graph.push(segment, (0.0, 0.0, 0.0))
        graph.until(is_last("FREE"), "the end of the contact")
        assert estimates[-1].force_low == 0.0 < estimates[-1].force_high
        return estimate

    contact = pushed(3, "CONTACT")
    assert contact.probability > 0.9
    assert not contact.moment_only
    size_n = math.hypot(contact.wrench.force.y, contact.wrench.force.z)
    assert contact.force_low <= size_n <= contact.force_high
    assert contact.place_low < contact.contact_point.x < contact.place_high
    assert np.linalg.eigvalsh(np.reshape(contact.covariance, (4, 4))).min() > 0.0

    assert contact.wrench_base.force.y == pytest.approx(contact.wrench.force.y, abs=1e-6)

    moment = pushed(1, "MOMENT")
    assert moment.moment_only
    assert moment.wrench.force == Vector3()
    assert moment.wrench.torque.z > 0.0
    assert math.isnan(moment.wrench_base.force.y)

    names = list(open_arm("cdsm").joint_names)
    graph.command.publish(JointState(name=names, position=[0.0, 0.2] * 4))
    graph.until(is_last("MOVING"), "a motion")
    assert math.isnan(estimates[-1].wrench.force.x)
    assert math.isnan(estimates[-1].force_high)


EXAMPLE = """<package format="3">
  <name>force_subscriber</name><version>0.0.0</version><description>An example.</description>
  <maintainer email="cablesense@example.org">CableSense developers</maintainer>
  <license>Apache-2.0</license>
  <depend>cablesense_msgs</depend><depend>rclcpp</depend>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""


@pytest.mark.timeout(600)
def test_the_subscriber_in_cpp_compiles_as_its_page_says(tmp_path):
    packages = pytest.importorskip("ament_index_python.packages")
    for name in ("ament_cmake", "rclcpp", "rosidl_default_generators"):
        try:
            packages.get_package_prefix(name)
        except (LookupError, OSError):
            pytest.skip(f"needs a ROS 2 installation: {name} is not installed")
    (lists,) = re.findall(
        "```cmake\n(.*?)```", (CHECKOUT / "docs/controller.md").read_text(), re.DOTALL
    )
    shutil.copytree(PACKAGE, tmp_path / "src/cablesense_msgs")
    example = tmp_path / "src/force_subscriber"
    example.mkdir()
    shutil.copy(CHECKOUT / "examples/force_subscriber.cpp", example)
    (example / "CMakeLists.txt").write_text(lists)
    (example / "package.xml").write_text(EXAMPLE)
    subprocess.run([sys.executable, "-m", "colcon", "build"], cwd=tmp_path, check=True)
    assert (tmp_path / "install/force_subscriber/lib/force_subscriber/force_subscriber").is_file()
