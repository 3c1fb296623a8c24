"""What tensions say of contacts on an arm that is known with tolerances only.

`law` is what a model file answers, `calibration` how well the arm is known, and `judgement` what
to state of a reading. Nothing here knows ROS, nodes, or how a model file was made.
"""
