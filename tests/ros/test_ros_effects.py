"""The sim node with an arm file that lists effects, over the real middleware."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from arm_variants import variant
from ros_graph import Graph, NodeProcess

from cablesense_sim.replay import replay_arm

rclpy = pytest.importorskip("rclpy", reason="no ROS 2 here")


pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

OFFSET = {"effect": "sensor_offset", "at": "cable_9", "parameters": {"offset_n": 7.0}}
PAYLOAD = {"effect": "payload", "at": "segment_4", "parameters": {"mass_kg": 0.4}}
FRICTION = {"effect": "joint_friction", "at": "joint_2", "parameters": {"torque_n_m": 0.2}}


@pytest.mark.parametrize("listed", [[OFFSET, PAYLOAD], [OFFSET, PAYLOAD, FRICTION]])
def test_an_amended_arm_is_published_as_the_replay_has_it(
    listed: list[dict[str, object]], tmp_path: Path
) -> None:
    arm = variant({"effects": listed, "sensors.rate_hz": 50}, "cdsm_lab")
    path = tmp_path / "amended.yaml"
    path.write_text(yaml.safe_dump(arm.model_dump()), encoding="utf-8")
    loads = np.zeros((2, 4, 3))
    loads[1, 2] = [0.0, 12.0, 0.0]
    expected = replay_arm(arm, np.array([0.0, 1.0]), np.zeros((2, 8)), loads)
    graph, sim = Graph(), NodeProcess("cablesense_ros.sim_node", arm=path, noise=False)
    try:
        graph.until(lambda: len(graph.tensions) > 10, "tensions")
        np.testing.assert_allclose(graph.tensions[-1].effort, expected[0], atol=1e-3)
        graph.push(3, loads[1, 2])

        def pushed():
            return np.abs(graph.tensions[-1].effort - expected[1]).max() < 1e-3

        graph.until(pushed, "the tensions of the replay under load")
        graph.until(lambda: "sim: simulation" in graph.statuses, "diagnostics")
        assert graph.statuses["sim: simulation"].hardware_id == arm.identity
    finally:
        code = sim.stop()
        graph.close()
    assert code == 0, sim.log
    assert "Traceback" not in sim.log
