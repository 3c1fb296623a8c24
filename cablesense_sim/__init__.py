"""The simulated arm: description, effects, equilibrium, replay and dynamics.

Short names for programs that use the arm:

    from cablesense_sim import open_arm, mechanism_of, solve_equilibrium

    arm = open_arm("cdsm")
    equilibrium = solve_equilibrium(mechanism_of(arm), command_rad, forces_n)

A name is imported when it is first used, so that `import cablesense_sim` itself costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
