"""Rotation matrices and quaternions agree with SciPy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cablesense_sim.rotations import quaternion_xyzw, rotation_matrix

VECTORS = st.lists(st.floats(-6.0, 6.0), min_size=3, max_size=3).map(np.array)


@given(VECTORS)
def test_a_matrix_turns_by_its_vector(vector: np.ndarray) -> None:
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(rotation_matrix(vector), expected, atol=1e-12)


def test_many_vectors_give_as_many_matrices() -> None:
    vectors = np.linspace(-1.0, 2.0, 24).reshape(2, 4, 3)
    each = [[rotation_matrix(vector) for vector in row] for row in vectors]
    np.testing.assert_allclose(rotation_matrix(vectors), each)


def test_no_turn_is_the_identity() -> None:
    np.testing.assert_array_equal(rotation_matrix(np.zeros(3)), np.eye(3))


@given(VECTORS)
def test_a_quaternion_is_the_rotation_that_it_was_made_of(vector: np.ndarray) -> None:
    rotation = rotation_matrix(vector)
    quaternion = quaternion_xyzw(rotation)
    assert max(quaternion, key=abs) > 0.0
    np.testing.assert_allclose(np.linalg.norm(quaternion), 1.0)
    np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), rotation, atol=1e-12)
