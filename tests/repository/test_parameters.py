"""Parameters stand in several lists: what the nodes declare, files for them, and the reference."""

import os
import subprocess
import sys

import pytest
import yaml

from cablesense_msgs_py.qos import RECORDED_TOPICS
from cablesense_online.settings import EstimationSettings
from cablesense_ros.node_process import parameter_table
from tests.helpers.checkout import CHECKOUT

REFERENCE = (CHECKOUT / "docs/ros_reference.md").read_text(encoding="utf-8")
NODES = ("sim", "estimator", "breather", "commissioner", "can_driver")
IN_RAD = {"joint_speed_deg_s": "joint_speed_rad_s", "still_deg": "still_rad"}
IN_RAD |= {"follow_deg_s": "follow_rad_s"}


def declared(node: str) -> dict[str, object]:
    return {parameter.name: parameter.default for parameter in parameter_table(node)}


@pytest.mark.parametrize("node", NODES)
def test_the_file_of_a_node_has_parameters_that_it_declares(node: str) -> None:
    text = (CHECKOUT / f"config/nodes/{node}.yaml").read_text(encoding="utf-8")
    given = next(iter(yaml.safe_load(text).values()))["ros__parameters"]
    assert set(given) <= set(declared(node)) | {"use_sim_time"}


def test_the_estimators_file_has_each_of_its_settings() -> None:
    text = (CHECKOUT / "config/nodes/estimator.yaml").read_text(encoding="utf-8")
    given = next(iter(yaml.safe_load(text).values()))["ros__parameters"]
    settings = {IN_RAD.get(name, name) for name in given}
    assert set(EstimationSettings.model_fields) <= settings


def test_the_reference_is_made_from_the_code() -> None:
    made = subprocess.run(
        [sys.executable, str(CHECKOUT / ".ci/reference")],
        capture_output=True,
        check=True,
        cwd=CHECKOUT,
        env={**os.environ, "PYTHONPATH": str(CHECKOUT)},
        text=True,
    )
    assert made.stdout == REFERENCE


def test_the_reference_has_every_topic() -> None:
    for topic in RECORDED_TOPICS:
        assert topic.strip("/~").split("{")[0] in REFERENCE, topic
