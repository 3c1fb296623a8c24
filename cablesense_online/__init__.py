"""Everything for a live arm that needs no ROS: estimation, CAN, sensors, control, replay.

Programs that have readings as arrays begin with a machine and how well it is known:

    from cablesense_online import KnownMachine

    arm = KnownMachine.load("my_arm.yaml", "my_arm.onnx").tared(untouched_n, command_rad)
    touch = arm.touch(reading_n, command_rad)

`Estimation` is what the estimator node does with messages, over time.

A name is imported when it is first used, so that `import cablesense_online` itself costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
