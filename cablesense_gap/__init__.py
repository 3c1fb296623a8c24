"""The gap between a recorded arm and the simulated one: what causes it, where, how far it shrinks.

A program that uses the diagnosis finds the names that it needs here:

    from cablesense_gap import diagnose
    from cablesense_recording import read_recording
    from cablesense_sim import open_arm

    arm = open_arm("cdsm_lab")
    diagnosis = diagnose(read_recording("recording.csv", arm), arm)
    print(diagnosis.verdict.effects, diagnosis.verdict.probability)

A name is imported when it is first used, so that `import cablesense_gap` itself costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
