"""The controller's demo: its metrics from a record, its picture, and the play."""

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)

from cablesense_online.admittance.estimate_watch import ContactState
from cablesense_ros.demo.wall import Moment, WallRecord, play_wall


def record(settling_s=3.0):
    times = np.arange(0.0, 20.0, 0.04)
    pressed = (times >= 1.0) & (times < 10.0)
    decay = 2.0 + 28.0 * np.exp(-(times - 1.0) * np.log(28.0) / settling_s)
    commands = np.zeros((len(times), 8))
    commands[(times >= 2.0) & (times < 15.0), 3] = 0.01
    states = tuple(ContactState.CONTACT if at else ContactState.FREE for at in pressed)
    true = np.where(pressed, decay, 0.0)
    return WallRecord(times, true, np.where(pressed, 30.0, 0.0), true, commands, states, 10.0)


def test_metrics_are_those_of_the_contact():
    found = record().metrics()
    assert found["without_controller_n"] == pytest.approx(30.0)
    assert found["peak_n"] == pytest.approx(30.0, abs=1.0)
    assert found["settled_n"] == pytest.approx(2.0, abs=0.01)
    assert found["settling_s"] == pytest.approx(3.0, abs=0.1)
    assert found["steps"] == 1
    assert found["left_from_home_deg"] == 0.0


@pytest.mark.slow  # matplotlib
def test_the_picture_is_written_whole(tmp_path):
    pytest.importorskip("matplotlib")
    from cablesense_ros.demo.pictures import draw_wall

    path = tmp_path / "admittance.png"
    draw_wall(path, record())
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_the_wall_of_the_play_moves_as_the_obstacles(monkeypatch):
    monkeypatch.setattr("cablesense_ros.demo.wall.PRESS_AT_S", 0.2)

    class Observer:
        asked = ()

        def move_wall(self, depth_m):
            self.asked = (*self.asked, depth_m)

        def moment(self):
            return Moment(1.0, 0.5, np.zeros(8), ContactState.UNKNOWN)

    observer = Observer()
    played = play_wall(observer, 1e4, 1.4, lambda: None)
    assert observer.asked == (0.003, -0.005)
    assert played.unyielding_n.max() == pytest.approx(30.0)
    assert played.unyielding_n[0] == played.unyielding_n[-1] == 0.0
    assert played.leaves_s == pytest.approx(0.7)
