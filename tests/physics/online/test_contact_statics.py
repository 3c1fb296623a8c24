"""Contacts on a bent arm in base axes and at the joints, against levers from turned vectors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_contact.felt_arm import FeltArm
from cablesense_msgs_py.messages import Contact
from cablesense_online.answer import ContactStatics
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
FIRST_JOINT_M = ARM.segments.plate_offset_m
LENGTH_M = ARM.segments.length_m
POSE_RAD = np.radians([12.0, -7.0, 4.0, 15.0, -20.0, 3.0, 9.0, -11.0])
STATICS = ContactStatics(FeltArm(ARM).links_at(POSE_RAD))
PUSH = Contact(3, angle_deg=130.0, magnitude_n=8.0, contact_m=0.09, along_n=2.5)
SECOND_PUSH = Contact(2, angle_deg=310.0, magnitude_n=5.0, contact_m=0.02)


class Bent:
    """The arm joint by joint: `turns` of the segments, `joints_m`, and axes of the joints."""

    def __init__(self) -> None:
        turn = Rotation.identity()
        joint_m = np.array([FIRST_JOINT_M, 0.0, 0.0])
        self.turns = []
        self.joints_m = []
        self.hinges = []
        for pitch, yaw in POSE_RAD.reshape(-1, 2):
            pitched = turn * Rotation.from_euler("y", pitch)
            self.hinges.append((turn.apply([0.0, 1.0, 0.0]), joint_m))
            self.hinges.append((pitched.apply([0.0, 0.0, 1.0]), joint_m))
            turn = pitched * Rotation.from_euler("z", yaw)
            self.turns.append(turn)
            self.joints_m.append(joint_m)
            joint_m = joint_m + turn.apply([LENGTH_M, 0.0, 0.0])

    def point_m(self, contact: Contact, further_m: float = 0.0) -> Array:
        n = contact.segment - 1
        along_m = [contact.contact_m + further_m, 0.0, 0.0]
        return np.asarray(self.joints_m[n] + self.turns[n].apply(along_m))

    def force_n(self, contact: Contact) -> Array:
        angle_rad = np.radians(contact.angle_deg)  # from z towards y
        y_n = contact.magnitude_n * np.sin(angle_rad)
        z_n = contact.magnitude_n * np.cos(angle_rad)
        return np.asarray(self.turns[contact.segment - 1].apply([contact.along_n, y_n, z_n]))

    def torques_n_m(self, contact: Contact) -> list[float]:
        """A joint feels what acts on segments beyond it, by the lever about its hinge."""
        moved = self.hinges[: 2 * contact.segment]
        point_m = self.point_m(contact)
        force_n = self.force_n(contact)
        felt = [float(axis @ np.cross(point_m - at_m, force_n)) for axis, at_m in moved]
        return felt + [0.0] * (len(self.hinges) - len(moved))


BENT = Bent()


@pytest.mark.parametrize("contacts", [[PUSH], [PUSH, SECOND_PUSH]])
def test_forces_and_their_moments_about_the_base_add_up(contacts: list[Contact]) -> None:
    forces_n = [BENT.force_n(contact) for contact in contacts]
    moments_n_m = [
        np.cross(BENT.point_m(contact), force_n)
        for contact, force_n in zip(contacts, forces_n, strict=True)
    ]
    expected = [*np.sum(forces_n, axis=0), *np.sum(moments_n_m, axis=0)]
    np.testing.assert_allclose(STATICS.base_wrench(contacts), expected, atol=1e-12)


@pytest.mark.parametrize("contacts", [[PUSH], [PUSH, SECOND_PUSH]])
def test_joints_feel_the_levers_about_their_hinges(contacts: list[Contact]) -> None:
    expected_n_m = np.sum([BENT.torques_n_m(contact) for contact in contacts], axis=0)
    np.testing.assert_allclose(STATICS.joint_torques_n_m(contacts), expected_n_m, atol=1e-12)


def test_of_a_first_segments_contact_the_moment_alone_gives_the_torques() -> None:
    push = Contact(1, angle_deg=70.0, magnitude_n=6.0, contact_m=0.05)
    moment = Contact(1, angle_deg=70.0, contact_m=0.05, moment_n_m=6.0 * 0.05)
    torques_n_m = STATICS.joint_torques_n_m([moment])
    np.testing.assert_allclose(torques_n_m, BENT.torques_n_m(push), atol=1e-12)
    assert STATICS.base_wrench([moment])[:3] == [0.0, 0.0, 0.0]


def test_a_contacts_pose_varies_with_its_place_and_its_direction() -> None:
    place_std_m = 0.012
    angle_std_deg = 2.0
    pose = STATICS.contact_pose(PUSH, place_std_m, angle_std_deg)
    np.testing.assert_allclose(pose.point_m, BENT.point_m(PUSH), atol=1e-12)

    turn = Rotation.from_quat(pose.quaternion)
    normal = BENT.force_n(PUSH._replace(along_n=0.0))
    np.testing.assert_allclose(turn.apply([8.0, 0.0, 0.0]), normal, atol=1e-12)
    along = BENT.turns[PUSH.segment - 1].apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(turn.apply([0.0, 0.0, 1.0]), along, atol=1e-12)

    step_m = BENT.point_m(PUSH, place_std_m) - BENT.point_m(PUSH)
    turned = BENT.force_n(PUSH._replace(angle_deg=PUSH.angle_deg + angle_std_deg, along_n=0.0))
    step_rad = np.cross(normal, turned)
    step_rad *= np.radians(angle_std_deg) / np.linalg.norm(step_rad)
    expected = np.zeros((6, 6))
    expected[:3, :3] = np.outer(step_m, step_m)
    expected[3:, 3:] = np.outer(step_rad, step_rad)
    np.testing.assert_allclose(np.reshape(pose.covariance, (6, 6)), expected, atol=1e-12)
