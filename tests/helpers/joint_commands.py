"""Messages of commanded joint angles, without ROS."""

from types import SimpleNamespace

from cablesense_msgs_py.messages import breath_frame


def joint_command(arm, angles_rad, turn=None, stamp_ns=0):
    """A command, or one of a breath in this turn."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    header = SimpleNamespace(
        frame_id="" if turn is None else breath_frame(turn),
        stamp=SimpleNamespace(sec=sec, nanosec=nanosec),
    )
    return SimpleNamespace(header=header, name=arm.joint_names, position=angles_rad)


def cable_offsets(arm, lengths_m, turn=None, stamp_ns=0):
    """Offsets of the cables, or those of a breath in this turn."""
    message = joint_command(arm, lengths_m, turn, stamp_ns)
    message.name = arm.cable_names
    return message
