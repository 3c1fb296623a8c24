"""A machine of MuJoCo as the page draws it: tendons, bodies, sliders, and a still picture."""

import numpy as np
import pytest

from cablesense_msgs_py.messages import Contact, ForceState, Level
from cablesense_online.page.shown import Mesh
from cablesense_online.page.shown_model import ShownModel
from cablesense_online.page.snapshot import ForceBounds, PlaceInterval, ShownStatus, Snapshot
from cablesense_online.page.still import still_picture
from cablesense_sim.machine.statics import MachineStatics
from tests.helpers.example_machines import bent_command, example_machine
from tests.helpers.rendering import need_renderer

MACHINES = ("finger", "hand", "seven_hinges", "continuum", "six_axis")


def drawn_lengths_m(shown, drawn):
    """(M,) of the read tendons, as they are drawn."""
    length_m = np.linalg.norm(drawn.piece_m[:, 1] - drawn.piece_m[:, 0], axis=-1)
    is_read = shown.piece_channel >= 0
    count = len(shown.felt.channels.names)
    return np.bincount(shown.piece_channel[is_read], length_m[is_read], count)


@pytest.mark.parametrize("name", ["seven_hinges", "continuum", "finger"])
def test_drawn_tendons_have_their_length_less_what_arcs_round_pulleys_add(name):
    machine = example_machine(name)
    shown = ShownModel(machine)
    statics = MachineStatics(machine)
    rng = np.random.default_rng(1)
    for _ in range(3):
        pose = machine.reference + rng.uniform(-0.1, 0.1, len(machine.reference))
        length_m = statics.at(pose).length_m
        drawn_m = drawn_lengths_m(shown, shown.drawn_at(pose))
        assert (drawn_m <= length_m + 1e-9).all()
        around = 0.001 if name == "finger" else 1e-9  # a chord instead of an arc
        np.testing.assert_allclose(drawn_m, length_m, atol=around)


@pytest.mark.parametrize("name", MACHINES)
def test_shapes_of_a_link_lie_around_the_axis_on_which_it_is_touched(name):
    machine = example_machine(name)
    shown = ShownModel(machine)
    drawn = shown.drawn_at(machine.reference)
    for n, (low_m, high_m) in enumerate(shown.touched_m):
        along = drawn.links.axes[n, :, 0]
        middle_m = drawn.links.origin_m[n] + 0.5 * (low_m + high_m) * along
        parts = [solid for solid in shown.solids if solid.link == n + 1]
        assert parts
        near_m = []
        for solid in parts:
            if isinstance(solid.shape, Mesh):
                local_m = solid.shape.vertices_m + np.array(solid.position_m)
                corners_m = drawn.body_m[solid.body] + local_m @ drawn.body_axes[solid.body].T
                aside_m = (corners_m - middle_m) - np.outer((corners_m - middle_m) @ along, along)
                near_m.append(np.linalg.norm(aside_m, axis=-1).max())
        assert max(near_m) == pytest.approx(machine.links.radius_m[n], rel=0.5)


@pytest.mark.parametrize("name", MACHINES)
def test_sliders_have_the_names_of_commands_and_their_home_is_the_first_one(name):
    machine = example_machine(name)
    shown = ShownModel(machine)
    felt = shown.felt
    assert [slider.label.split(",")[0] for slider in shown.sliders] == list(felt.command_names)
    home = np.array([slider.home / slider.per_unit for slider in shown.sliders])
    np.testing.assert_allclose(home, felt.first_command, atol=1e-4)
    for slider in shown.sliders:
        assert slider.lowest < slider.home < slider.highest
    names = [name for panel in shown.panels for name in panel.names]
    assert sorted(names) == sorted(felt.channels.names)


def test_a_command_near_the_first_pose_is_that_of_the_turned_joints():
    for name in ("finger", "continuum"):
        machine = example_machine(name)
        shown = ShownModel(machine)
        rng = np.random.default_rng(3)
        turn_rad = np.deg2rad(rng.uniform(-8.0, 8.0, len(machine.coordinates)))
        expected = bent_command(machine, 3)
        np.testing.assert_allclose(shown.command_near(turn_rad), expected, atol=1e-12)


def test_a_still_picture_shows_both_forces_and_the_place():
    need_renderer()
    machine = example_machine("finger")
    shown = ShownModel(machine)
    still = Snapshot(
        time_s=0.0,
        pose=machine.reference,
        frame_pose=machine.reference,
        readings=machine.tendons.pretension_n,
        true=(),
        state=ForceState.FREE,
        estimated=(),
        bounds=None,
        probabilities=None,
        status=ShownStatus(Level.OK, "No contact"),
    )
    touched = Snapshot(
        **{
            **still.__dict__,
            "true": (Contact(2, 215.0, 3.0, 0.012),),
            "estimated": (Contact(2, 218.0, 3.1, 0.015),),
            "bounds": ForceBounds(2.5, 3.5, (200.0, 230.0)),
            "region": (PlaceInterval(2, 0.010, 0.020),),
        }
    )
    free_px = still_picture(shown, still, 320, 180).astype(int)
    touched_px = still_picture(shown, touched, 320, 180).astype(int)

    def orange(pixels):
        return ((pixels[..., 0] > 170) & (pixels[..., 2] < 60)).sum()

    def blue(pixels):
        return ((pixels[..., 2] > 170) & (pixels[..., 0] < 120)).sum()

    assert orange(free_px) == 0
    assert orange(touched_px) > 30
    assert blue(touched_px) > blue(free_px) + 60
