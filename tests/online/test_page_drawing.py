"""The drawn arm: cables, arrows, colours and traces agree with mechanism and data."""

import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cablesense_online.page.drawing import (
    ARROW_LONGEST_M,
    ARROW_METRES_PER_NEWTON,
    INTERVAL_FACES,
    arrow_tail_m,
    cable_pieces,
    full_scale_n,
    interval_wedge_m,
    linear_rgb,
    quaternion_z_to,
    tension_rgb,
)
from cablesense_online.page.traces import TraceBuffer
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.kinematics import cable_lengths_m, joint_positions_m, segment_rotations


@pytest.fixture(scope="module", params=["cdsm", "cdsm_table2"])
def mechanism(request):
    return mechanism_of(open_arm(request.param))


def drawn_cables(mechanism, q):
    positions, rotations = joint_positions_m(mechanism, q), segment_rotations(mechanism, q)
    return cable_pieces(mechanism, positions, rotations)


def test_drawn_cables_are_as_long_as_the_mechanism_says(mechanism):
    rng = np.random.default_rng(4)
    for _ in range(20):
        q = rng.uniform(-0.35, 0.35, mechanism.joint_count)
        ends_m, cable = drawn_cables(mechanism, q)
        lengths = np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=-1)
        drawn = np.bincount(cable, lengths, mechanism.cable_count)
        np.testing.assert_allclose(drawn, cable_lengths_m(mechanism, q), atol=1e-12)


def test_a_cable_is_drawn_without_gaps_and_ends_on_its_own_segment(mechanism):
    q = np.full(mechanism.joint_count, 0.1)
    ends_m, of_cable = drawn_cables(mechanism, q)
    for cable, segment in enumerate(mechanism.cable_segment):
        ends = ends_m[of_cable == cable]
        np.testing.assert_array_equal(ends[1:, 0], ends[:-1, 1])
        joint = joint_positions_m(mechanism, q)[segment - 1]
        assert np.linalg.norm(ends[-1, 1] - joint) < 0.1


def test_arrow_length_is_proportional_to_force_within_its_limits():
    def length_m(newtons):
        tail, tip = arrow_tail_m(np.zeros(3), np.array([0.0, 0.0, newtons]), 0.0)
        return np.linalg.norm(tip - tail)

    assert length_m(100.0) == pytest.approx(100.0 * ARROW_METRES_PER_NEWTON)
    assert length_m(60.0) == pytest.approx(2.0 * length_m(30.0))
    assert length_m(1e6) == ARROW_LONGEST_M
    assert 0.0 < length_m(1e-3) < length_m(20.0)


forces = arrays(float, 3, elements=st.floats(-300.0, 300.0)).filter(
    lambda force: np.linalg.norm(force) > 1e-3
)


@given(force=forces)
def test_arrow_pushes_towards_the_contact(force):
    contact = np.array([0.3, 0.01, -0.02])
    tail, tip = arrow_tail_m(contact, force, clearance_m=0.02)
    unit = force / np.linalg.norm(force)
    np.testing.assert_allclose((tip - tail) / np.linalg.norm(tip - tail), unit, atol=1e-9)
    np.testing.assert_allclose(contact - tip, 0.02 * unit, atol=1e-12)


@given(force_n=st.floats(20.0, 200.0), angle_deg=st.floats(0.0, 360.0))
def test_the_wedge_has_the_tails_of_all_forces_in_the_stated_interval(force_n, angle_deg):
    def tail(force_n, angle_deg):
        angle = np.radians(angle_deg)
        force = force_n * np.array([0.0, np.sin(angle), np.cos(angle)])
        return arrow_tail_m(contact, force, 0.02)[0], force

    contact, along = np.array([0.3, 0.01, -0.02]), np.array([1.0, 0.0, 0.0])
    ends_n, turns_deg = (0.6 * force_n, 1.1 * force_n), (-50.0, 20.0)
    force = tail(force_n, angle_deg)[1]
    corners = interval_wedge_m(contact, force, along, 0.02, ends_n, tuple(np.radians(turns_deg)))
    for ray, turn_deg in ((0, -50.0), (-1, 20.0)):
        low, high, high_too, low_too = corners.reshape(-1, 4, 3)[ray] - contact
        for ends, end_n in (((low, low_too), ends_n[0]), ((high, high_too), ends_n[1])):
            there = tail(end_n, angle_deg + turn_deg)[0] - contact
            middle = np.mean(ends, axis=0)
            np.testing.assert_allclose(np.linalg.norm(ends, axis=1), np.linalg.norm(there))
            np.testing.assert_allclose(np.cross(middle, there), 0.0, atol=1e-12)
            assert middle @ there > 0.0
    assert trimesh.Trimesh(corners, INTERVAL_FACES, process=False).is_watertight


@given(force=forces)
@example(force=np.array([0.0, 0.0, -2.0]))
def test_quaternion_turns_z_into_the_force(force):
    w, x, y, z = quaternion_z_to(force)
    turned = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(turned, force / np.linalg.norm(force), atol=1e-6)


def test_tension_colours_get_lighter_with_tension_so_that_grey_vision_reads_them():
    colours = tension_rgb(np.linspace(0.0, 100.0, 50), 100.0).astype(float)
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > 0).all()


def test_tension_colours_hold_at_the_ends_and_survive_nan():
    ends = tension_rgb([-5.0, 0.0, 100.0, 900.0, np.nan], 100.0)
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[2], ends[3])
    np.testing.assert_array_equal(ends[4], ends[0])
    np.testing.assert_array_equal(linear_rgb(np.array([0, 255], dtype=np.uint8)), [0, 255])


@given(peak=st.floats(0.0, 1e5))
def test_full_scale_covers_the_peak_without_waste(peak):
    scale = full_scale_n(peak)
    assert scale >= peak
    assert scale == 100.0 or scale <= 1.51 * peak


def test_keeps_the_last_window_thinned_evenly():
    buffer = TraceBuffer(3, window_s=2.0, samples=20)
    assert [len(column) for column in buffer.columns] == [2] * 4, "an empty plot can be drawn"
    for tick in range(1000):
        buffer.add(tick * 0.01, np.array([tick, 0.0, -tick], dtype=float))
    times, first, second, third = buffer.columns
    assert len(times) == len(first) == len(second) == len(third) <= 20
    assert times[-1] == 0.0
    assert times[0] >= -2.0
    assert (np.diff(times) > 0.09).all()
    np.testing.assert_array_equal(third, -first)
    assert buffer.peak == first.max()


def test_a_clock_that_jumps_back_starts_anew():
    buffer = TraceBuffer(1, window_s=2.0, samples=20)
    buffer.add(100.0, np.array([900.0]))
    buffer.add(1.0, np.array([5.0]))
    buffer.add(2.0, np.array([6.0]))
    np.testing.assert_array_equal(buffer.columns[1], [5.0, 6.0])
    assert buffer.peak == 6.0
