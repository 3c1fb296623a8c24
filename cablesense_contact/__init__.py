"""What tensions say of contacts on an arm that is known with tolerances only.

Short names for programs that estimate contacts from arrays:

    from cablesense_contact import Calibrator, FeltArm, Judge, LawModel, Unloaded, find_model

    law = LawModel(find_model("cdsm_anywhere"), arm)
    calibrator = Calibrator(FeltArm(arm), law)
    calibration = calibrator.updated(calibrator.by_tolerances(), Unloaded(reading_n, command_rad))

`law` is what a model file answers, `calibration` how well the arm is known, and `judgement` what
to state of a reading. Nothing here knows ROS, nodes, or how a model file was made. A name is
imported when it is first used, so that `import cablesense_contact` itself costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
