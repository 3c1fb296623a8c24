"""Recordings of an arm or a robot as .mcap files, made without nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rosbags.typesys import Stores, get_typestore

from cablesense_msgs_py import topics
from cablesense_msgs_py.qos import INPUTS, JOINT_STATE_TYPE, NUMBER_TYPE, WRENCH_TYPE, resolved
from cablesense_recording.mcap_messages import TopicFile
from cablesense_sim.build import mechanism_of
from cablesense_sim.kinematics import contact_points_m

STORE = get_typestore(Stores.ROS2_JAZZY)
START_NS = 1_000_000_000
"""Stamp of a recording's time 0: a stamp of 0 would mean that there is none."""


class Bag:
    """A file of a recording's topics; `log_ns` is when a message came, 0 is no stamp."""

    def __init__(self, path, space=""):
        self.space = space
        self.file = TopicFile(path)
        self.channels = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()

    def joint_state(self, topic, log_ns, stamp_ns, names, **fields):
        values = {
            name: np.ascontiguousarray(value, dtype=np.float64) for name, value in fields.items()
        }
        empty = {name: np.empty(0) for name in ("position", "velocity", "effort")}
        header = header_of(stamp_ns, "base_link")
        message = STORE.types[JOINT_STATE_TYPE](header, list(names), **(empty | values))
        self.put(topic, log_ns, message)

    def load(self, log_ns, stamp_ns, frame_id, force_n, torque_n_m=(0.0, 0.0, 0.0)):
        vector = STORE.types["geometry_msgs/msg/Vector3"]
        force = vector(*map(float, force_n))
        torque = vector(*map(float, torque_n_m))
        wrench = STORE.types["geometry_msgs/msg/Wrench"](force, torque)
        message = STORE.types[WRENCH_TYPE](header_of(stamp_ns, frame_id), wrench)
        self.put(topics.APPLIED_WRENCH, log_ns, message)

    def trial(self, log_ns, number):
        self.put(topics.TRIAL, log_ns, STORE.types[NUMBER_TYPE](number))

    def put(self, topic, log_ns, message):
        contract = INPUTS.get(topic, INPUTS[topics.CABLE_TENSIONS])
        kind = contract.kind
        if topic not in self.channels:
            self.channels[topic] = self.file.add(
                resolved(topic, self.space or "/"), kind, contract.offered
            )
        self.file.write(self.channels[topic], log_ns, bytes(STORE.serialize_cdr(message, kind)))


def write_mcap(path, recording, arm, space="", arrives_s=None):
    """A recording as the topics of a running arm, every value with each row.

    `space` is the name space of the topics, `arrives_s` when the first row came and how much later
    each other; without it messages come when their stamps say.
    """
    mechanism = mechanism_of(arm)
    places_m = recording.load_at_m
    places_m = np.full(len(recording), np.nan) if places_m is None else places_m
    with Bag(path, space) as bag:
        for row in range(len(recording)):
            stamp = START_NS + round((recording.time_s[row] - recording.time_s[0]) * 1e9)
            came_ns = stamp
            if arrives_s is not None:
                came_ns = START_NS + round((arrives_s[0] + arrives_s[1] * row) * 1e9)
            bag.trial(came_ns, int(recording.trial[row]))
            command = recording.command_rad[row]
            tensions_n = recording.tensions_n[row]
            bag.joint_state(
                topics.JOINT_COMMANDS, came_ns, stamp, arm.joint_names, position=command
            )
            for segment in range(1, arm.segment_count + 1):
                force = (segment == recording.load_segment[row]) * recording.load_n[row]
                bag.load(came_ns, stamp, f"segment_{segment}", force)
                if force.any() and np.isfinite(places_m[row]):
                    there = replace(mechanism, contact_m=np.full(arm.segment_count, places_m[row]))
                    point_m = contact_points_m(there, command)[segment - 1]
                    bag.load(came_ns, stamp, "base_link", force, np.cross(point_m, force))
            bag.joint_state(
                topics.CABLE_TENSIONS, came_ns, stamp, arm.cable_names, effort=tensions_n
            )


def write_joint_states(path, table, topic="/joint_states", joints=None):
    """A robot's table as a bag: a state by row, and a trial's number where the table has them.

    `joints` are the names in the messages by those in the table. An effort that is no number in
    all joints is left out of its message.
    """
    joint_names = [name.partition(".")[2] for name in table if name.startswith("position.")]
    joints = joints or {name: name for name in joint_names}
    with Bag(path) as bag:
        for k, row in enumerate(table.to_dict("records")):
            log_ns = START_NS * 100 + k * 10_000_000
            stamp_ns = START_NS + round(1e9 * row["time_s"])
            if "trial" in row:
                bag.trial(log_ns, int(row["trial"]))
            position = [row[f"position.{name}"] for name in joint_names]
            effort = [row.get(f"torque.{name}", np.nan) for name in joint_names]
            effort = effort if np.isfinite(effort).any() else []
            names = [joints[name] for name in joint_names]
            bag.joint_state(topic, log_ns, stamp_ns, names, position=position, effort=effort)
    return path


def header_of(stamp_ns, frame_id):
    stamp = STORE.types["builtin_interfaces/msg/Time"](*divmod(int(stamp_ns), 1_000_000_000))
    return STORE.types["std_msgs/msg/Header"](stamp, frame_id)
