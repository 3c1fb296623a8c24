"""The controller's demo: its figures from a record, and its picture."""

import numpy as np
import pytest

from cablesense_online.admittance.estimate_watch import Sight
from cablesense_online.admittance.wall import Approach
from cablesense_ros.demo.admittance import AdmittanceRecord, figures


def record(settling_s=3.0):
    times = np.arange(0.0, 20.0, 0.04)
    pressed = (times >= 1.0) & (times < 10.0)
    decay = 2.0 + 28.0 * np.exp(-(times - 1.0) * np.log(28.0) / settling_s)
    commands = np.zeros((len(times), 8))
    commands[(times >= 2.0) & (times < 15.0), 3] = 0.01
    sights = tuple(Sight.CONTACT if at else Sight.FREE for at in pressed)
    true = np.where(pressed, decay, 0.0)
    return AdmittanceRecord(
        times, true, np.where(pressed, 30.0, 0.0), true, commands, sights, 10.0
    )


def test_figures_are_those_of_the_contact():
    found = figures(record(), deadband_n=2.0)
    assert found["without_controller_n"] == pytest.approx(30.0)
    assert found["peak_n"] == pytest.approx(30.0, abs=1.0)
    assert found["settled_n"] == pytest.approx(2.0, abs=0.01)
    assert found["settling_s"] == pytest.approx(3.0, abs=0.1)
    assert found["steps"] == 1
    assert found["left_from_home_deg"] == 0.0


def test_the_picture_is_written_whole(tmp_path):
    pytest.importorskip("matplotlib")
    from cablesense_ros.demo.pictures import draw_admittance

    path = tmp_path / "admittance.png"
    draw_admittance(path, record(), 3, 2.0)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(tmp_path.iterdir()) == [path]


def test_the_wall_of_the_play_moves_as_the_obstacles():
    pytest.importorskip("rclpy")
    from cablesense_ros.demo.admittance import play_wall

    class Observer:
        asked = ()

        def move_wall(self, depth_m):
            self.asked = (*self.asked, depth_m)

        def moment(self):
            return 1.0, 0.5, np.zeros(8), Sight.BLIND

    observer = Observer()
    played = play_wall(observer, 0.003, -0.005, Approach(-0.005, 1.0), 1e4, 2.4, lambda: None)
    assert observer.asked == (0.003, -0.005)
    assert played.unyielding_n.max() == pytest.approx(30.0)
    assert played.unyielding_n[0] == played.unyielding_n[-1] == 0.0
    assert played.leaves_s == pytest.approx(1.2)
