"""An admittance controller: it moves the simulated arm away from an elastic wall.

    python -m examples.admittance

`law` computes one step, `trust` decides whether the estimates can be relied on, `controller` is
the cycle of both, `wall` the obstacle; `controller_node` and `wall_node` connect them to ROS.
docs/controller.md derives the law and its stability.
"""
