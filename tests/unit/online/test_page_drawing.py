"""The drawn arm: cables, arrows, colours and traces agree with mechanism and data."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from cablesense_contact.felt_arm import FeltArm
from cablesense_online.page.arrows import ArrowScale, arrow_m, place_m, pulled_contact
from cablesense_online.page.figures import covered_m, html, interval_text, known_text, places_text
from cablesense_online.page.headline import Words
from cablesense_online.page.marks import interval_outline_m, place_band
from cablesense_online.page.shown_arm import ShownArm, cable_pieces
from cablesense_online.page.snapshot import ForceBounds, PlaceInterval
from cablesense_online.page.traces import TraceBuffer, reading_lines
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.kinematics import cable_lengths_m, joint_positions_m

CONTACT = np.array([0.3, 0.01, -0.02])
SCALE = ArrowScale(size_m=0.5, strongest_n=200.0)


@pytest.mark.parametrize("name", ["cdsm", "cdsm_table2"])
def test_drawn_cables_have_no_gap_the_right_length_and_end_on_their_segment(name):
    arm = open_arm(name)
    mechanism = mechanism_of(arm)
    felt = FeltArm(arm)
    rng = np.random.default_rng(4)
    for _ in range(5):
        q = rng.uniform(-0.35, 0.35, mechanism.joint_count)
        ends_m, of_cable = cable_pieces(mechanism, felt.links_at(q))
        lengths = np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=-1)
        drawn = np.bincount(of_cable, lengths, mechanism.cable_count)
        np.testing.assert_allclose(drawn, cable_lengths_m(mechanism, q), atol=1e-12)
        joints_m = joint_positions_m(mechanism, q)
        for cable, segment in enumerate(mechanism.cable_segment):
            ends = ends_m[of_cable == cable]
            np.testing.assert_array_equal(ends[1:, 0], ends[:-1, 1])
            assert np.linalg.norm(ends[-1, 1] - joints_m[segment - 1]) < 0.1


forces = arrays(float, 3, elements=st.floats(-300.0, 300.0)).filter(
    lambda force: np.linalg.norm(force) > 1e-3
)


@given(force=forces)
def test_an_arrow_pushes_towards_the_contact_and_is_as_long_as_its_force(force):
    tail, tip = arrow_m(CONTACT, force, 0.02, SCALE)
    newtons = np.linalg.norm(force)
    length = np.linalg.norm(tip - tail)
    np.testing.assert_allclose((tip - tail) / length, force / newtons, atol=1e-9)
    np.testing.assert_allclose(CONTACT - tip, 0.02 * force / newtons, atol=1e-12)
    if 30.0 < newtons < 200.0:
        assert length == pytest.approx(0.75 * newtons / 200.0 * 0.5)
    assert 0.05 - 1e-12 <= length <= 0.425 + 1e-12
    small = np.diff(arrow_m(CONTACT, force / 40.0, 0.0, ArrowScale(0.1, 5.0)), axis=0)
    assert np.linalg.norm(small) == pytest.approx(length / 5.0)


@given(
    force=forces.filter(lambda force: np.linalg.norm(force[1:]) > 1e-3),
    low_n=st.floats(0.0, 250.0),
    wider_n=st.floats(0.0, 250.0),
    first_deg=st.floats(0.0, 360.0, exclude_max=True),
    wide_deg=st.floats(0.0, 359.0),
)
def test_the_outline_of_an_interval_is_where_its_arrows_may_begin(
    force, low_n, wider_n, first_deg, wide_deg
):
    """Contact angles grow from +z to +y: a force at the angle a is (0, sin a, cos a)."""
    axis = np.array([1.0, 0.0, 0.0])
    angle_deg = float(np.rad2deg(np.arctan2(force[1], force[2])))
    high_n = low_n + wider_n
    bounds = ForceBounds(low_n, high_n, (first_deg, (first_deg + wide_deg) % 360.0))
    lines_m = interval_outline_m(CONTACT, axis, force, angle_deg, bounds, 0.02, SCALE)
    np.testing.assert_allclose(lines_m[1:, 0], lines_m[:-1, 1])
    np.testing.assert_allclose(lines_m[-1, 1], lines_m[0, 0])
    away_m = lines_m[:, 0] - CONTACT
    np.testing.assert_allclose(away_m @ axis, 0.0, atol=1e-12)
    near_m, far_m = (0.02 + SCALE.length_m(end_n) for end_n in (low_n, high_n))
    half = len(lines_m) // 2
    np.testing.assert_allclose(np.linalg.norm(away_m[:half], axis=1), near_m)
    np.testing.assert_allclose(np.linalg.norm(away_m[half : 2 * half], axis=1), far_m)
    turned_deg = first_deg + np.linspace(0.0, wide_deg, half)
    turn = np.deg2rad(turned_deg)
    rays = np.column_stack([0.0 * turn, np.sin(turn), np.cos(turn)])
    np.testing.assert_allclose(away_m[:half], -near_m * rays, atol=1e-9)


def test_an_outline_of_any_angle_is_a_ring():
    force = np.array([0.0, 0.0, 30.0])
    bounds = ForceBounds(20.0, 40.0)
    lines_m = interval_outline_m(CONTACT, np.eye(3)[0], force, 0.0, bounds, 0.02, SCALE)
    first_m, last_m = lines_m[0, 0], lines_m[len(lines_m) // 2 - 1, 0]
    np.testing.assert_allclose(first_m, last_m, atol=1e-12)


def test_a_place_that_is_known_well_still_has_a_band_that_can_be_seen():
    band = place_band(PlaceInterval(2, 0.05, 0.08), 0.5)
    assert (band.middle_m, band.length_m) == pytest.approx((0.065, 0.03))
    thin = place_band(PlaceInterval(2, 0.05, 0.05), 0.5)
    assert thin.middle_m == 0.05
    assert 0.001 < thin.length_m < 0.01


@given(
    along_m=st.floats(0.0, 0.13),
    eye=arrays(float, 3, elements=st.floats(-2.0, 2.0)),
    turn=st.floats(-0.3, 0.3),
)
def test_a_ray_through_the_axis_meets_it_at_its_place(along_m, eye, turn):
    axis = np.array([np.cos(turn), 0.0, np.sin(turn)])
    ray = CONTACT + along_m * axis - eye
    assume(np.linalg.norm(np.cross(ray, axis)) > 0.01)
    assert place_m(CONTACT, axis, eye, 3.0 * ray) == pytest.approx(along_m, abs=1e-6)


@given(pull_m=arrays(float, 3, elements=st.floats(-0.4, 0.4)), along_m=st.floats(0.0, 0.13))
def test_a_drag_pulls_where_the_segment_is_held_by_the_force_of_as_long_an_arrow(pull_m, along_m):
    at_command = Rotation.from_euler("yz", [0.1, -0.2]).as_matrix()
    as_measured = Rotation.from_euler("yz", [0.12, -0.19]).as_matrix()
    axis = as_measured[:, 0]
    held_m = CONTACT + along_m * axis + 0.02 * as_measured[:, 2]  # on the surface
    ends_m = np.stack([held_m, held_m + pull_m])
    contact = pulled_contact(2, CONTACT, axis, at_command, ends_m, SCALE)
    assert contact.segment == 2
    assert contact.contact_m == pytest.approx(along_m)
    force_n = at_command @ contact.wrench[:3]
    np.testing.assert_allclose(force_n, 200.0 / 0.375 * pull_m, atol=1e-9)
    if 0.1 < np.linalg.norm(pull_m) < 0.4:
        assert SCALE.length_m(np.linalg.norm(force_n)) == pytest.approx(np.linalg.norm(pull_m))


@pytest.mark.parametrize(
    ("value", "ends", "stated"),
    [
        (59.3551, (59.331, 59.379), ("59.36", "59.33 to 59.38")),
        (65.03, (64.9, 65.2), ("65.0", "64.9 to 65.2")),
        (48.0, (20.4, 90.3), ("48", "20 to 90")),
        (60.87, (59.84, 61.26), ("60.9", "59.8 to 61.3")),
        (5.04, (355.2, 14.9), ("5", "355 to 15")),
        (0.0, (0.0, 0.0), ("0.00", "0.00 to 0.00")),
    ],
)
def test_numbers_have_the_digits_that_their_interval_leaves(value, ends, stated):
    assert (known_text(value, *ends), interval_text(*ends)) == stated


def test_an_interval_of_places_may_end_on_another_segment():
    whole = [PlaceInterval(2, 0.0521, 0.0734)]
    words = Words("arm", "segment", ("1", "2", "3", "4"))
    assert places_text(whole, words) == "52 to 73 mm"
    two = [PlaceInterval(2, 0.121, 0.13), PlaceInterval(3, 0.0, 0.014)]
    assert places_text(two, words) == "121 mm of 2 to 14 mm of 3"
    assert covered_m(two) == pytest.approx(0.023)


@pytest.mark.parametrize("per_segment", [3, 5])
def test_every_cable_has_its_name_its_tension_and_a_line_of_its_own(per_segment):
    (panel,) = ShownArm(open_arm("cdsm")).panels
    numbers = np.repeat(np.arange(1, 5), per_segment)
    names = tuple(f"cable_{n}" for n in range(1, len(numbers) + 1))
    groups = tuple(f"segment {n}" for n in numbers)
    panel = dataclasses.replace(panel, names=names, groups=groups)
    lines = reading_lines(panel)
    assert tuple(line.name for line in lines) == names
    assert len({(line.colour, *line.dash) for line in lines}) == len(names)
    tensions_n = np.linspace(31.0, 80.0, len(names))
    shown = re.sub(r"<[^>]*>|\s+", " ", html("readings", panel, lines, tensions_n, 100.0)).split()
    for name, tension_n in zip(names, tensions_n, strict=True):
        assert shown[shown.index(name) + 1] == f"{tension_n:.0f}"
    assert "–" in html("readings", panel, lines, None, 100.0)


def test_traces_keep_the_last_window_thinned_evenly():
    buffer = TraceBuffer(2, window_s=2.0, samples=20)
    assert [len(column) for column in buffer.columns] == [2] * 3, "an empty plot can be drawn"
    for tick in range(1000):
        buffer.add(tick * 0.01, np.array([tick, -tick], dtype=float))
    times, first, second = buffer.columns
    assert len(times) == len(first) <= 20
    assert (times[0] >= -2.0, times[-1]) == (True, 0.0)
    assert (np.diff(times) > 0.09).all()
    np.testing.assert_array_equal(second, -first)
    assert buffer.peak == np.abs(second).max()
    for time_s, value in ((1.0, 5.0), (2.0, 6.0)):  # a clock that jumps back starts anew
        buffer.add(time_s, np.array([value, 0.0]))
    np.testing.assert_array_equal(buffer.columns[1], [5.0, 6.0])
