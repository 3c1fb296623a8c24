"""A machine and its model by the names that a user gives: an arm, or any machine of MuJoCo."""

from __future__ import annotations

from cablesense_online.models import Loaded, load_model
from cablesense_sim.machine.description import is_machine_file


def load(arm: str, model: str) -> Loaded:
    """Load by name or path; an empty `model` takes the bundled one, or the one beside the file.

    Args:
        arm: name or path of an arm file, or path of a machine file.
        model: name or path of a model file.

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another machine.
    """
    if is_machine_file(arm):
        # the estimator of an arm needs no MuJoCo
        from cablesense_online.machine_models import load_machine

        return load_machine(arm, model)
    return load_model(arm, model)
