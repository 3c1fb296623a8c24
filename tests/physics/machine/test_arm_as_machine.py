"""An arm gives the same estimates by its arm file and by the MJCF that CableSense writes of it."""

from pathlib import Path

import numpy as np
import yaml

from cablesense_contact.law import LawOutput
from cablesense_contact.machine.law import MachineLaw
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.machine.machine import Machine, open_machine
from cablesense_sim.machine.parameters import MachineParameters
from cablesense_sim.machine.simulated import SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from cablesense_sim.model import build_spec
from cablesense_sim.touch import touched_places
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.law.build import TorchLaw
from tests.helpers.torch_stater import TorchStater

CONTACTS = 24
SHARE = 0.01
"""Of a deviation, by which estimates may differ."""


def stated_arm() -> Arm:
    """An arm whose tolerances a machine file can state too.

    Holes and lengths are exact: an arm's plates have one hole error for both plates of a segment,
    a machine's sites have one each. Both are without friction.
    """
    arm = open_arm("cdsm_lab")
    exact = {
        "hole_radial_m": 0.0,
        "hole_around_m": 0.0,
        "segment_length_m": 0.0,
        "friction_coefficient": 0.0,
    }
    return arm.model_copy(update={"tolerances": arm.tolerances.model_copy(update=exact)})


def as_machine(arm: Arm, folder: Path) -> Machine:
    """The same arm by its MJCF, with the same tolerances."""
    mechanism = mechanism_of(arm)
    spec = build_spec(mechanism)
    spec.compile()
    (folder / "arm.xml").write_text(spec.to_xml())
    places = touched_places(arm)
    tolerances = arm.tolerances
    links = [
        {
            "link": f"segment_{n + 1}",
            "start_m": [float(low_m), 0.0, 0.0],
            "end_m": [float(high_m), 0.0, 0.0],
            "radius_m": float(places.radius_m[n]),
        }
        for n, (low_m, high_m) in enumerate(places.touched_m)
    ]
    file = {
        "name": "arm",
        "model": "arm.xml",
        "joints": "commanded",
        "sensors": {
            "tension": {
                "of": list(arm.cable_names),
                "noise_std": arm.sensors.noise_std_n,
                "step": arm.sensors.step_n,
            }
        },
        "cables": {
            "stiffness_n_m": float(mechanism.stiffness_n_m[0]),
            "pretension_n": float(mechanism.pretension_n[0]),
            "friction_coefficient": 0.0,
        },
        "touch": {"links": links, "friction": places.friction},
        "tolerances": {
            "stiffness_share": tolerances.cable_stiffness_share,
            "pretension_n": tolerances.pretension_n,
            "routing_m": 0.0,
            "mass_share": tolerances.segment_mass_share,
            "centre_of_mass_m": tolerances.centre_of_mass_m,
            "base_tilt_deg": tolerances.base_tilt_deg,
            "gain_share": tolerances.sensor_gain_share,
            "zero_n": tolerances.sensor_zero_n,
            "joint_zero_deg": tolerances.joint_zero_deg,
        },
    }
    (folder / "arm.yaml").write_text(yaml.safe_dump(file))
    return open_machine(folder / "arm.yaml")


def test_estimates_by_arm_file_and_by_mjcf_agree(tmp_path: Path) -> None:
    arm = stated_arm()
    machine = as_machine(arm, tmp_path)
    law_of_arm = TorchLaw(arm)
    law_of_machine = MachineLaw(machine, TorchStater(machine))
    parameters = MachineParameters(machine)
    described = SimulatedMachine(machine, parameters, np.zeros(len(parameters)))
    rng = np.random.default_rng(5)
    readings = []
    commands = []
    for _ in range(CONTACTS):
        command = np.deg2rad(rng.uniform(-10.0, 10.0, arm.joint_count))
        link = int(rng.integers(1, len(machine.links.names)))
        place_m = float(rng.uniform(*machine.links.touched_m[link]))
        force_n = np.array([2.0, *rng.uniform(-15.0, 15.0, 2)])
        contact = LinkForce(link, np.array([place_m, 0.0, 0.0]), force_n)
        rest = described.touched(command, (contact,), described.untouched(command))
        readings.append(machine.channels.read(rest.values, rng))
        commands.append(command)

    def stated(law: TorchLaw | MachineLaw, std: np.ndarray) -> LawOutput:
        count = arm.joint_count
        still = np.zeros((count, count))
        exact = np.zeros(len(std))
        return law(np.array(readings), np.array(commands), exact, np.diag(std**2), still)

    by_file = stated(law_of_arm, arm_parameters(arm).prior_std)
    by_mjcf = stated(law_of_machine, parameters.prior_std)
    std = np.sqrt(np.diagonal(by_file.contact_covariance, axis1=1, axis2=2))
    np.testing.assert_array_equal(
        by_file.contact_evidence.argmax(axis=1), by_mjcf.contact_evidence.argmax(axis=1)
    )
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(by_mjcf.contact_covariance, axis1=1, axis2=2)) / std, 1.0, atol=SHARE
    )
    assert np.abs((by_mjcf.place_m - by_file.place_m) / std[:, 0]).max() < SHARE
    assert np.abs((by_mjcf.force_n - by_file.force_n) / std[:, 1:]).max() < SHARE
    np.testing.assert_allclose(by_mjcf.free_chi2, by_file.free_chi2, rtol=0.02)
