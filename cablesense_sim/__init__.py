"""The simulated arm: description, effects, equilibrium, replay and dynamics.

What a program that uses the arm needs stands here by short names::

    from cablesense_sim import open_arm, mechanism_of, solve_equilibrium

    arm = open_arm("cdsm")
    rest = solve_equilibrium(mechanism_of(arm), command_rad, forces_n)

A name is imported when it is first used, so that `import cablesense_sim` itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablesense_sim.arm import Arm as Arm
    from cablesense_sim.arm import ArmFileError as ArmFileError
    from cablesense_sim.arm import bundled_arms as bundled_arms
    from cablesense_sim.arm import load_arm as load_arm
    from cablesense_sim.arm import open_arm as open_arm
    from cablesense_sim.arm import parse_arm as parse_arm
    from cablesense_sim.build import mechanism_of as mechanism_of
    from cablesense_sim.dynamics import moving_arm as moving_arm
    from cablesense_sim.effects.effect import Actuation as Actuation
    from cablesense_sim.effects.effect import Effect as Effect
    from cablesense_sim.effects.effect import Parameter as Parameter
    from cablesense_sim.effects.effect import Sensing as Sensing
    from cablesense_sim.effects.registry import EffectError as EffectError
    from cablesense_sim.effects.registry import known_effects as known_effects
    from cablesense_sim.effects.transmission import Transmission as Transmission
    from cablesense_sim.equilibrium import Equilibrium as Equilibrium
    from cablesense_sim.equilibrium import EquilibriumError as EquilibriumError
    from cablesense_sim.equilibrium import solve_equilibrium as solve_equilibrium
    from cablesense_sim.loads import LoadError as LoadError
    from cablesense_sim.loads import contact_angle_deg as contact_angle_deg
    from cablesense_sim.loads import normal_force_n as normal_force_n
    from cablesense_sim.mechanism import Mechanism as Mechanism
    from cablesense_sim.model import build_spec as build_spec
    from cablesense_sim.replay import replay_arm as replay_arm
    from cablesense_sim.sensors import read_tensions_n as read_tensions_n
    from cablesense_sim.urdf import urdf_xml as urdf_xml

_MODULES = {
    "arm": ("Arm", "ArmFileError", "bundled_arms", "load_arm", "open_arm", "parse_arm"),
    "build": ("mechanism_of",),
    "dynamics": ("moving_arm",),
    "effects.effect": ("Actuation", "Effect", "Parameter", "Sensing"),
    "effects.registry": ("EffectError", "known_effects"),
    "effects.transmission": ("Transmission",),
    "equilibrium": ("Equilibrium", "EquilibriumError", "solve_equilibrium"),
    "loads": ("LoadError", "contact_angle_deg", "normal_force_n"),
    "mechanism": ("Mechanism",),
    "model": ("build_spec",),
    "replay": ("replay_arm",),
    "sensors": ("read_tensions_n",),
    "urdf": ("urdf_xml",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_MODULE_OF)
