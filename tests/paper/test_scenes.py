"""The scenes are the models that are measured, with a camera that sees them."""

import numpy as np
import pytest

from cablesense_paper.cables import SCENES, camera, scene


@pytest.mark.parametrize("name", SCENES)
def test_light_and_enlarged_blocks_change_no_cable(name):
    model, data = scene(name)
    tensions = model.tendon_stiffness * (data.ten_length - model.tendon_lengthspring[:, 1])
    np.testing.assert_allclose(tensions, 50.0, atol=1e-5)


@pytest.mark.parametrize("name", SCENES)
def test_the_camera_looks_at_the_middle(name):
    _, data = scene(name)
    middle = 0.5 * (data.geom_xpos.min(axis=0) + data.geom_xpos.max(axis=0))
    assert np.abs(camera(name).lookat - middle).max() < 0.15
