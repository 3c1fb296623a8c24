"""The headless demo's script of pushes, and what its report makes of a record."""

import io
from itertools import pairwise

import numpy as np
import pytest
from rich.console import Console

from cablesense_msgs_py.messages import ForceState, Level
from cablesense_online.page.live_arm import ShownContact, ShownStatus, Snapshot
from cablesense_ros.demo.pushes import (
    PushRecord,
    PushResult,
    ScriptError,
    make_script,
    metrics,
    push_results,
    results_table,
    summary,
)

pytest.importorskip("rclpy", reason="needs ROS 2, or its wheels", exc_type=ImportError)


def recorded(script, estimate_of, unknown=None):
    times = np.arange(0.0, script[-1].end_s, 0.04)
    snapshots = []
    for time_s in times:
        push = next((p for p in script if p.start_s <= time_s < p.end_s), None)
        estimate = estimate_of(push) if push else None
        pose = np.zeros(8)
        state = unknown or (ForceState.CONTACT if estimate else ForceState.FREE)
        status = ShownStatus(Level.OK, "fine")
        tensions = np.full(12, 50.0)
        snapshots.append(
            Snapshot(time_s, pose, tensions, None, state, estimate, None, None, status)
        )
    return PushRecord(times, snapshots)


def exact(push):
    return ShownContact(push.segment, push.angle_deg, push.magnitude_n, np.zeros(3))


def test_a_minute_visits_every_segment_straight_and_bent():
    script = make_script(4, 60.0, seed=0)
    assert script[-1].end_s <= 60.0
    assert {push.segment for push in script} == {1, 2, 3, 4}
    assert any(push.command_rad.any() for push in script)
    assert any(not push.command_rad.any() for push in script)
    assert all(a.end_s < b.start_s for a, b in pairwise(script))
    assert all(push.move_s < push.start_s < push.end_s for push in script)


def test_a_weak_arm_is_pushed_in_its_own_range():
    strong, weak = make_script(4, 60.0, seed=0), make_script(4, 60.0, seed=0, range_n=2.0)
    for push, gentle in zip(strong, weak, strict=True):
        assert gentle.magnitude_n == pytest.approx(push.magnitude_n / 100.0, rel=0.01)


def test_the_seed_makes_the_script():
    first, again = (make_script(4, 60.0, seed=7) for _ in range(2))
    assert [p.angle_deg for p in first] == [p.angle_deg for p in again]
    assert [p.angle_deg for p in first] != [p.angle_deg for p in make_script(4, 60.0, seed=8)]


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 3.9, float("nan")])
def test_no_script_without_room_for_a_push(duration_s):
    with pytest.raises(ScriptError, match="one push takes"):
        make_script(4, duration_s, seed=0)


def test_exact_estimates_have_no_error():
    script = make_script(4, 60.0, seed=0)
    results = push_results(script, recorded(script, exact))
    found = summary(results)
    assert found["segment_right"] == found["pushes"] == len(script)
    assert found["direction_mae_deg"] == pytest.approx(0.0, abs=1e-9)
    assert found["magnitude_mae_n"] == pytest.approx(0.0, abs=1e-9)


def test_directions_are_averaged_across_north():
    script = make_script(4, 4.0, seed=0)
    flip = iter([359.0, 1.0] * 1000)
    record = recorded(script, lambda p: ShownContact(p.segment, next(flip), 10.0, np.zeros(3)))
    (result,) = push_results(script, record)
    angle = result.estimate.angle_deg
    assert min(angle, 360.0 - angle) <= 1.0


def test_a_wrong_segment_has_no_direction_error():
    script = make_script(4, 4.0, seed=0)
    wrong = ShownContact(script[0].segment + 1, 0.0, 10.0, np.zeros(3))
    (result,) = push_results(script, recorded(script, lambda _: wrong))
    assert not result.segment_right
    assert result.angle_error_deg is None
    assert summary([result])["magnitude_mae_n"] is None


def test_silence_and_no_contact_are_told_apart():
    script = make_script(4, 4.0, seed=0)
    (silent,) = push_results(script, recorded(script, exact, unknown=ForceState.SILENT))
    (none,) = push_results(script, recorded(script, lambda _: None))
    assert (silent.sample_count, silent.estimate) == (0, None)
    assert none.sample_count > 10
    assert none.estimate is None
    output = io.StringIO()
    Console(file=output, width=80).print(results_table([silent, none]))
    assert "no estimate" in output.getvalue()
    assert "no contact" in output.getvalue()


def test_the_table_fits_eighty_columns_with_every_figure():
    script = make_script(4, 60.0, seed=0)
    results = push_results(script, recorded(script, exact))
    output = io.StringIO()
    Console(file=output, width=80).print(results_table(results))
    for push in script:
        assert f"{push.angle_deg:.1f}°" in output.getvalue()
        assert f"{push.magnitude_n:.1f} N" in output.getvalue()


def test_json_has_what_the_table_has():
    script = make_script(4, 4.0, seed=0)
    none = PushResult(script[0], None, 5)
    figures = metrics([none])
    assert figures["pushes"][0]["estimated"] is None
    assert figures["summary"]["segment_right"] == 0


@pytest.mark.slow  # matplotlib
def test_the_picture_is_whole_and_not_empty(tmp_path):
    pytest.importorskip("matplotlib")
    from PIL import Image

    from cablesense_ros.demo.pictures import draw_pushes
    from cablesense_sim.arm import open_arm
    from cablesense_sim.build import mechanism_of

    script = make_script(4, 12.0, seed=0)
    force = np.array([0.0, 20.0, -30.0])
    record = recorded(script, lambda p: ShownContact(p.segment, p.angle_deg, p.magnitude_n, force))
    path = tmp_path / "demo.png"
    results = push_results(script, record)
    draw_pushes(path, mechanism_of(open_arm("cdsm")), record, results)
    image = np.asarray(Image.open(path).convert("RGB"))
    assert image.shape[0] > 600
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 200
    assert list(tmp_path.iterdir()) == [path]
