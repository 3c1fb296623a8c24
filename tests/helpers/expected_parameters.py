"""What is known of an arm that nobody has recorded."""

import numpy as np

from cablesense_gap.arm_nuisance import FittedParameters, fitted_parameters
from cablesense_gap.diagnosis.nuisance_posterior import NuisancePosterior
from cablesense_sim.arm import Arm


def expected_parameters(arm: Arm) -> FittedParameters:
    """Its uncertain parameters by its tolerances."""
    nothing = NuisancePosterior((), np.zeros(0), np.zeros((0, 0)))
    return fitted_parameters(arm, arm, nothing)
