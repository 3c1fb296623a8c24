"""Everything for a live arm that needs no ROS: estimation, CAN, sensors, control, replay.

Programs that estimate contacts import these short names:

    from cablesense_online import Estimation, EstimationSettings, load_model

    loaded = load_model("cdsm", "")
    settings = EstimationSettings(contact_threshold=0.5, ...)
    contacts = loaded.contacts(settings)
    estimation = Estimation(loaded.machine, contacts, settings, time.monotonic())
    answer = estimation.sample(serialized_joint_state, time.time_ns(), time.monotonic())

A name is imported when it is first used, so that `import cablesense_online` itself costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
