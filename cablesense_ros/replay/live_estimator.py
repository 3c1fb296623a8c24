"""An estimator that runs, as a replay sees it: inputs go out, answers come back."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_msgs_py import topics
from cablesense_msgs_py.stamped_bytes import stamp_ns
from cablesense_msgs_py.topic_types import CONTRACT, INPUTS, resolved
from cablesense_ros.estimator_parameters import LIVE_PARAMETERS
from cablesense_ros.message_classes import message_class
from cablesense_ros.qos_profiles import qos_profile

PATIENCE_S = 10.0
_LOOK_S = 0.0005


class LiveEstimator:
    """Publishers, a subscription and service clients; another thread spins the node.

    Attributes:
        answers: serialized wrenches by their stamps, until someone takes them out.
    """

    def __init__(self, node: Node, namespace: str) -> None:
        self._node = node
        self._namespace = namespace
        self.answers: dict[int, bytes] = {}
        self._out: dict[str, Publisher] = {
            topic: node.create_publisher(
                message_class(INPUTS[topic].kind), self._name(topic), qos_profile(qos.offered)
            )
            for topic, qos in INPUTS.items()
        }
        self._wrenches = node.create_subscription(
            WrenchStamped,
            self._name(topics.WRENCH),
            self._on_answer,
            qos_profile(CONTRACT[topics.WRENCH].heard),
            raw=True,
        )
        self._parameters = node.create_client(GetParameters, self._name("~/get_parameters"))
        self._set_parameters = node.create_client(SetParameters, self._name("~/set_parameters"))
        self._clients: dict[str, Client] = {
            name: node.create_client(Trigger, self._name(name))
            for name in (topics.TARE, topics.TARE_UNDO)
        }

    def wait_until_there(self) -> None:
        """Until an estimator listens and is heard.

        Raises:
            RecordingError: none is there within `PATIENCE_S`.
        """
        tensions = self._out[topics.CABLE_TENSIONS]
        commands = self._out[topics.JOINT_COMMANDS]
        wrench = self._name(topics.WRENCH)
        there = self._until(
            lambda: bool(
                tensions.get_subscription_count()
                and commands.get_subscription_count()
                and self._node.count_publishers(wrench)
            ),
            PATIENCE_S,
        )
        if not there:
            raise RecordingError(
                f"no estimator takes {self._name(topics.CABLE_TENSIONS)} and publishes {wrench}; "
                "start one, in this ROS_DOMAIN_ID and namespace"
            )

    def publish(self, topic: str, raw: bytes) -> None:
        """One serialized message on an input topic."""
        self._out[topic].publish(raw)

    def command(self, names: Sequence[str], angles_rad: Sequence[float]) -> None:
        """A command, which the estimator has dealt with when this returns."""
        self._out[topics.JOINT_COMMANDS].publish(
            JointState(name=list(names), position=list(angles_rad))
        )
        # the middleware's acknowledgement takes seconds; a question that comes behind the command
        # is answered behind it
        answer = self._parameters.call_async(GetParameters.Request())
        self._until(answer.done, PATIENCE_S)

    def call(self, service: str) -> None:
        """`~/tare` or `~/tare_undo`, done when this returns.

        Raises:
            RecordingError: the estimator refuses, or does not answer.
        """
        future = self._clients[service].call_async(Trigger.Request())
        if not self._until(future.done, PATIENCE_S):
            raise RecordingError(f"{self._name(service)} does not answer")
        response = future.result()
        if response is None or not response.success:
            why = "" if response is None else response.message
            raise RecordingError(
                f"{self._name(service)} refuses what it took when recorded: {why}; was the "
                "estimator started afresh?"
            )

    def adjust(self, settings: Mapping[str, str]) -> None:
        """Set the parameters that may change while it runs, as a journal entry has them.

        Raises:
            RecordingError: the estimator refuses one, or does not answer.
        """
        future = self._set_parameters.call_async(
            SetParameters.Request(
                parameters=[
                    Parameter(name, value=float(settings[name])).to_parameter_msg()
                    for name in LIVE_PARAMETERS
                ]
            )
        )
        if not self._until(future.done, PATIENCE_S):
            raise RecordingError(f"{self._name('~/set_parameters')} does not answer")
        refused = [result.reason for result in future.result().results if not result.successful]
        if refused:
            raise RecordingError(f"{self._name('~/set_parameters')}: {'; '.join(refused)}")

    def wait_for(self, stamp: int, patience_s: float = 1.0) -> bool:
        """Until the answer with a stamp is here; whether it is."""
        return self._until(lambda: stamp in self.answers, patience_s)

    def _on_answer(self, raw: bytes) -> None:
        self.answers[stamp_ns(raw)] = raw

    def _name(self, topic: str) -> str:
        return resolved(topic, self._namespace)

    @staticmethod
    def _until(condition: Callable[[], bool], patience_s: float) -> bool:
        end_s = time.monotonic() + patience_s
        while not condition():
            if time.monotonic() > end_s:
                return False
            time.sleep(_LOOK_S)
        return True
