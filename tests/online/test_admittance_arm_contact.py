"""Where wall and arm meet: touching at advance 0, and the arm's compliance as statics has it."""

import numpy as np
import pytest

from cablesense_base.errors import CableSenseError
from cablesense_online.admittance.wall import compliance_m_n, contact_point_m, wall_beside
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium

POSE = np.deg2rad([3.0, -2.0, 1.0, 4.0, -3.0, 2.0, 0.0, 1.0])


@pytest.mark.parametrize("segment", [1, 2, 3, 4])
@pytest.mark.parametrize("arm", ["cdsm", "cdsm_lab"])
def test_compliance_is_how_far_a_small_push_moves_the_contact(arm, segment):
    mechanism = mechanism_of(open_arm(arm))
    wall = wall_beside(mechanism, POSE, segment, 130.0, 1e4, 0.0)
    forces = np.zeros((4, 3))
    forces[segment - 1] = 0.1 * wall.normal
    moved = [
        contact_point_m(mechanism, rest.joint_angles_rad, segment)
        for rest in (solve_equilibrium(mechanism, POSE, f) for f in (forces, -forces))
    ]
    expected = wall.normal @ (moved[0] - moved[1]) / 0.2
    assert compliance_m_n(mechanism, POSE, segment, wall.normal) == pytest.approx(
        expected, rel=1e-4
    )


def test_a_wall_touches_at_advance_zero_and_pushes_as_the_contact_angle_says():
    mechanism = mechanism_of(open_arm("cdsm"))
    wall = wall_beside(mechanism, np.zeros(8), 3, 90.0, 1e4, 0.0)
    point = contact_point_m(mechanism, np.zeros(8), 3)
    assert np.allclose(wall.normal, [0.0, 1.0, 0.0])
    assert wall.penetration_m(point, 0.0) == 0.0
    assert wall.penetration_m(point, 0.002) == pytest.approx(0.002)


def test_a_segment_that_is_not_there_is_refused():
    mechanism = mechanism_of(open_arm("cdsm"))
    with pytest.raises(CableSenseError, match="segment"):
        wall_beside(mechanism, np.zeros(8), 5, 0.0, 1e4, 0.0)
