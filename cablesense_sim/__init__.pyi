"""Public names; `__init__.py` imports each when it is first used."""

from .arm import Arm as Arm
from .arm import ArmFileError as ArmFileError
from .arm import bundled_arms as bundled_arms
from .arm import load_arm as load_arm
from .arm import open_arm as open_arm
from .arm import parse_arm as parse_arm
from .build import mechanism_of as mechanism_of
from .dynamics import moving_arm as moving_arm
from .effects.effect import Actuation as Actuation
from .effects.effect import Effect as Effect
from .effects.effect import Parameter as Parameter
from .effects.effect import Sensing as Sensing
from .effects.effect import Transmission as Transmission
from .effects.registry import EffectError as EffectError
from .effects.registry import known_effects as known_effects
from .equilibrium import Equilibrium as Equilibrium
from .equilibrium import EquilibriumError as EquilibriumError
from .equilibrium import solve_equilibrium as solve_equilibrium
from .loads import LoadError as LoadError
from .loads import contact_angle_deg as contact_angle_deg
from .loads import normal_force_n as normal_force_n
from .mechanism import Mechanism as Mechanism
from .model import build_spec as build_spec
from .replay import read_tensions_n as read_tensions_n
from .replay import replay_arm as replay_arm
from .urdf import urdf_xml as urdf_xml
