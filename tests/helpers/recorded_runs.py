"""Recordings of a run as `cablesense record` writes them, made without nodes, in any order."""

from __future__ import annotations

from array import array
from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import MultiArrayDimension, UInt8MultiArray

from benchmarks.estimation_settings import estimation_settings
from cablesense_contact.calibration_file import calibration_bytes
from cablesense_contact.felt_arm import FeltArm
from cablesense_msgs_py import topics
from cablesense_msgs_py.messages import BREATH_END, breath_frame
from cablesense_msgs_py.qos import RECORDED_TOPICS, recorded_topic, resolved
from cablesense_msgs_py.serialized import wrench_writers
from cablesense_msgs_py.topics import Frames
from cablesense_online.estimation import Estimation
from cablesense_online.models import load_model
from cablesense_online.provenance import Beginning, Provenance
from cablesense_recording.mcap_messages import TopicFile
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from tests.helpers.joint_commands import joint_command

SETTINGS = estimation_settings(tare_samples=10, settle_s=0.05)
LOW_THRESHOLD = 1e-9
"""So low that noise is a contact."""
EPOCH_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
BREATH = {60: 0, 70: 1, 90: 2, 105: 0, 110: BREATH_END}
"""Turns of a breath, by the samples that they begin at; from 140 on readings are corrected."""


class MadeRun:
    """A live run: loads come and go, a command, a tare and its undo, and a breath if wanted.

    Attributes:
        records: topic of the contract, time of arrival, bytes.
        loaded: arm and model.
    """

    def __init__(
        self,
        samples: int = 200,
        model: str = "",
        *,
        breath: bool = False,
        unknown_force: str = "zero",
        adjusted: bool = False,
    ) -> None:
        """Of the arm `cdsm_lab`; `adjusted` lowers the threshold of contacts before the push."""
        self.loaded = load_model("cdsm_lab", model)
        loaded = self.loaded
        arm = loaded.arm
        settings = SETTINGS.model_copy(update={"unknown_force": unknown_force})
        live = Estimation(FeltArm(arm), loaded.contacts(settings), settings, 0.0)
        provenance = Provenance(loaded.path, loaded.sha256, arm.identity, "", settings)
        writers = wrench_writers(Frames(arm.segment_count))
        mechanism = mechanism_of(arm)
        rng = np.random.default_rng(5)
        angles = np.zeros(8)
        force = np.zeros((4, 3))
        self.records: list[tuple[str, int, bytes]] = []

        def note_calibration(now):
            command_rad = tuple(live.state.motion.command_rad.tolist())
            beginning = Beginning(
                now, live.state.stamps.last_ns, command_rad, live.state.unloaded.known
            )
            content = calibration_bytes(live.state.unloaded.calibration)
            message = UInt8MultiArray(data=array("B", content))
            in_force = replace(provenance, settings=live.settings)
            label = in_force.as_json(beginning)
            message.layout.dim = [MultiArrayDimension(label=label)]
            self.records.append((topics.CALIBRATION_USED, now, serialize_message(message)))

        note_calibration(EPOCH_NS - STEP_NS)
        for i in range(samples):
            now = EPOCH_NS + i * STEP_NS
            if i == samples // 4:
                force[2] = (0.0, 20.0, 7.0)
            if i == samples // 2:
                angles = np.full(8, 0.002)
                message = JointState(name=list(arm.joint_names), position=angles.tolist())
                self.records.append((topics.JOINT_COMMANDS, now, serialize_message(message)))
                live.command(joint_command(arm, angles))
            if breath and i in BREATH:
                message = JointState(name=list(arm.cable_names), position=[1e-5] * 12)
                message.header.frame_id = breath_frame(BREATH[i])
                message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
                self.records.append((topics.CABLE_OFFSETS, now, serialize_message(message)))
                live.offset(message)
            if i == samples - 40:
                live.take_tare(now, forced=True)
                note_calibration(now)
            if adjusted and i == samples // 8:
                live.adjust(LOW_THRESHOLD, settings.stale_after_s, settings.slack_below_n)
                note_calibration(now)
            if i == samples - 20:
                live.undo_tare(now)
                note_calibration(now)
            tensions = solve_equilibrium(mechanism, angles, force).tensions_n
            message = JointState(
                name=list(arm.cable_names), effort=(tensions + rng.normal(0, 0.05, 12)).tolist()
            )
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
            raw = serialize_message(message)
            answer = live.sample(raw, now, i * STEP_NS * 1e-9)
            self.records.append((topics.CABLE_TENSIONS, now + 100_000, raw))
            answers = [(topics.WRENCH, answer.contact.segment, answer.wrench(unknown_force))]
            for n in range(1, 5 if live.estimator.contacts.on_each_segment else 1):
                on_it = answer.on_segment(n, unknown_force)
                answers.append((topics.SEGMENT_WRENCHES.format(n), n, on_it))
            for topic, segment, wrench in answers:
                if wrench is not None:
                    written = writers[segment].write(now, wrench)
                    self.records.append((topic, now + 400_000, written))
            status = DiagnosticArray(status=[DiagnosticStatus(message=answer.force.value)])
            status.header.stamp = message.header.stamp
            self.records.append((topics.STATUS, now + 450_000, serialize_message(status)))
            if answer.new_tare is not None:
                note_calibration(now + 500_000)

    def write(self, path, records=None, namespace="/", kinds=()):
        """Put records into a file; `kinds` replaces types of topics."""
        file = TopicFile(path)
        channels = {}
        for topic, log_ns, raw in self.records if records is None else records:
            if topic not in channels:
                of = RECORDED_TOPICS[recorded_topic(resolved(topic))]
                kind = dict(kinds).get(topic, of.kind)
                channels[topic] = file.add(resolved(topic, namespace), kind, of.offered)
            file.write(channels[topic], log_ns, raw)
        file.close()
        return path
