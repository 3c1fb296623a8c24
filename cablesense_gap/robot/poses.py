"""Joint positions by inverse kinematics, of a machine whose frames are tracked from outside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_gap.robot.model import Robot
from cablesense_recording.recording import RecordingError

LEAST_RATIO: Final = 1e-3
"""Singular values of the Jacobian, by the largest, from which on a joint is determined."""
_DETERMINED_SHARE = 0.99
"""Least share of the probed rows in which a joint must be determined."""
_PROBED_ROWS = 50
"""Rows in which that is asked, spread evenly over the recording."""
_LARGEST_RESIDUAL_SHARE: Final = 0.2
"""RMS by which the best joint positions miss a frame's place, as a share of its motion, from which
on the pose is of another frame, or in other axes than those of the model's base."""
_STARTS = 24
"""Postures from which a row that follows no other is sought: one that is known, others random."""
_STEPS_FROM_START = 60
"""At most, of a descent from one of these."""
_STEPS_FROM_ROW_BEFORE = 12
"""At most, of a descent from the posture of the row before."""
_SMALLEST_STEP = 1e-10
"""rad or m; a descent ends where no joint goes farther."""
_LEAST_DAMPING = 1e-9
"""Of a descent, as a share of the mean diagonal of the normal equations."""
_SAME_POSTURE_WITHIN = 1e-3
"""rad or m; postures of which a joint differs by more are two."""


@dataclass(frozen=True)
class TrackedFrame:
    """A frame of the model whose pose was measured, in the axes of the model's base.

    Attributes:
        name: of the body or site.
        number: in the model.
        is_site: whether it is a site; else a body.
    """

    name: str
    number: int
    is_site: bool


def pose_frames(robot: Robot) -> tuple[str, ...]:
    """Names of the bodies and sites that joints move, which poses may be of."""
    model = robot.model
    moved = model.body_weldid != 0
    bodies = [model.body(b).name for b in range(1, model.nbody) if moved[b]]
    sites = [model.site(s).name for s in range(model.nsite) if moved[model.site_bodyid[s]]]
    return tuple(dict.fromkeys(name for name in (*sites, *bodies) if name))


class PoseKinematics:
    """Positions of the joints that make the poses of frames."""

    def __init__(self, robot: Robot) -> None:
        """Take the robot that was tracked."""
        self._robot = robot
        self._model = robot.model
        self._data = mujoco.MjData(robot.model)

    def positions(
        self, poses: Mapping[str, Array], known: Array, restarts: Sequence[int] = ()
    ) -> tuple[Array, list[str]]:
        """Joint positions (R, J) that fit the poses best, and sentences about them.

        `poses` has (R, 3) places of markers, m, or (R, 7) poses with a quaternion w x y z, by
        frame. `known` is (R, J), NaN for joints that were not measured, which are sought alone. In
        the rows `restarts` the machine may be anywhere; else a row follows the one before it. Rows
        in which a pose is NaN are NaN.

        Raises:
            RecordingError: the poses do not determine the joints, or are of other frames or axes.
        """
        frames = {name: self._frame(name) for name in poses}
        sought = np.flatnonzero(np.isnan(known).all(axis=0))
        complete = np.all([np.isfinite(pose).all(axis=1) for pose in poses.values()], axis=0)
        rows = np.flatnonzero(complete)
        positions = known.copy()
        starts = {int(rows[0]), *restarts} if rows.size else set()
        present = self._model.qpos0.copy()
        left: list[Array] = []
        several = False
        for row in rows.tolist():
            held = ~np.isnan(known[row])
            present[held] = known[row, held]
            measured = [(frames[name], pose[row]) for name, pose in poses.items()]
            if row in starts:
                present, alternatives = self._posture(present, sought, measured)
                several |= alternatives
            else:
                present = self._descent(present, sought, measured, _STEPS_FROM_ROW_BEFORE)
            positions[row, sought] = present[sought]
            left.append(self._residual(present, measured)[0])
        self._refuse_undetermined(positions[rows], sought, frames, poses)
        return positions, self._judged(np.array(left), poses, rows, sought, several=several)

    def _frame(self, name: str) -> TrackedFrame:
        site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
        if site >= 0:
            return TrackedFrame(name, site, is_site=True)
        body = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, name)
        return TrackedFrame(name, body, is_site=False)

    def _residual(
        self, position: Array, measured: Sequence[tuple[TrackedFrame, Array]]
    ) -> tuple[Array, Array]:
        """What poses (E,) are off, m and rad, and the Jacobian (E, J) of the frames there."""
        model = self._model
        data = self._data
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        off = []
        jacobians = []
        for frame, pose in measured:
            along = np.zeros((3, model.nv))
            about = np.zeros((3, model.nv))
            if frame.is_site:
                mujoco.mj_jacSite(model, data, along, about, frame.number)
                place_m = data.site_xpos[frame.number]
                rotation = data.site_xmat[frame.number]
            else:
                mujoco.mj_jacBody(model, data, along, about, frame.number)
                place_m = data.xpos[frame.number]
                rotation = data.xmat[frame.number]
            off.append(pose[:3] - place_m)
            jacobians.append(along)
            if len(pose) == 7:
                reached = np.empty(4)
                mujoco.mju_mat2Quat(reached, rotation)
                turned = np.empty(3)
                mujoco.mju_subQuat(turned, pose[3:] / np.linalg.norm(pose[3:]), reached)
                off.append(rotation.reshape(3, 3) @ turned)
                jacobians.append(about)
        return np.concatenate(off), np.concatenate(jacobians)

    def _descent(
        self,
        position: Array,
        sought: NDArray[np.int64],
        measured: Sequence[tuple[TrackedFrame, Array]],
        steps: int,
    ) -> Array:
        """Levenberg's descent from a posture: positions (J,) at a least sum of squares."""
        best = position.copy()
        off, jacobian = self._residual(best, measured)
        square = float(off @ off)
        damping = _LEAST_DAMPING
        for _ in range(steps):
            columns = jacobian[:, sought]
            normal = columns.T @ columns
            scale = max(float(np.trace(normal)) / max(len(sought), 1), 1e-12)
            step = np.linalg.solve(normal + damping * scale * np.eye(len(sought)), columns.T @ off)
            tried = best.copy()
            tried[sought] += step
            tried_off, tried_jacobian = self._residual(tried, measured)
            tried_square = float(tried_off @ tried_off)
            if tried_square < square:
                best = tried
                off = tried_off
                jacobian = tried_jacobian
                square = tried_square
                damping = max(0.1 * damping, _LEAST_DAMPING)
            else:
                damping = max(10.0 * damping, 1e-6)
            if np.abs(step).max(initial=0.0) < _SMALLEST_STEP or damping > 1e6:
                break
        return best

    def _posture(
        self,
        position: Array,
        sought: NDArray[np.int64],
        measured: Sequence[tuple[TrackedFrame, Array]],
    ) -> tuple[Array, bool]:
        """The posture that fits best, of several the nearest to the model's own; if any are."""
        model = self._model
        rng = np.random.default_rng(0)
        low = np.where(model.jnt_limited, model.jnt_range[:, 0], -np.pi)
        high = np.where(model.jnt_limited, model.jnt_range[:, 1], np.pi)
        postures = []
        for number in range(_STARTS):
            begin = position.copy()
            if number:
                begin[sought] = rng.uniform(low, high)[sought]
            posture = self._descent(begin, sought, measured, _STEPS_FROM_START)
            hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
            turned = hinge & ~model.jnt_limited.astype(bool)
            turned &= np.isin(np.arange(model.nv), sought)
            around = (posture - model.qpos0 + np.pi) % (2.0 * np.pi) - np.pi
            posture[turned] = (model.qpos0 + around)[turned]
            postures.append(posture)
        squares = [float((self._residual(each, measured)[0] ** 2).sum()) for each in postures]
        limit = min(squares) + max(1e-8, 0.1 * min(squares))
        within = [each for each, square in zip(postures, squares, strict=True) if square <= limit]
        allowed = [each for each in within if ((each >= low) & (each <= high))[sought].all()]
        within = allowed or within
        distances = [float(np.abs(each - model.qpos0)[sought].sum()) for each in within]
        nearest = within[int(np.argmin(distances))]
        apart = [float(np.abs(each - nearest)[sought].max(initial=0.0)) for each in within]
        return nearest, max(apart) > _SAME_POSTURE_WITHIN

    def _refuse_undetermined(
        self,
        positions: Array,
        sought: NDArray[np.int64],
        frames: Mapping[str, TrackedFrame],
        poses: Mapping[str, Array],
    ) -> None:
        """Refuse poses that leave a joint free: its column of the Jacobian is of the others'."""
        probed = np.linspace(0, len(positions) - 1, min(len(positions), _PROBED_ROWS)).astype(int)
        free = np.zeros(len(sought), dtype=np.int64)
        for row in probed.tolist():
            empty = [(frames[name], np.ones(pose.shape[1])) for name, pose in poses.items()]
            _, jacobian = self._residual(positions[row], empty)
            columns = jacobian[:, sought]
            _, singular, axes = np.linalg.svd(columns)
            ratios = np.append(singular, np.zeros(len(sought) - len(singular)))
            null = axes[ratios < LEAST_RATIO * max(float(ratios.max(initial=0.0)), 1e-9)]
            free += (np.abs(null) > 0.1).any(axis=0)
        undetermined = free > (1.0 - _DETERMINED_SHARE) * len(probed)
        if undetermined.any():
            names = [self._robot.joint_names[joint] for joint in sought[undetermined]]
            named = some_of([f"pose.{name}" for name in poses])
            raise RecordingError(
                f"{named} {'does' if len(poses) == 1 else 'do'} not determine {some_of(names)}; "
                "record their positions, or the pose of a frame behind each"
            )

    def _judged(
        self,
        left: Array,
        poses: Mapping[str, Array],
        rows: NDArray[np.int64],
        sought: NDArray[np.int64],
        *,
        several: bool,
    ) -> list[str]:
        """Sentences, or a refusal where a pose is left by much."""
        first = 0
        worst_mm = 0.0
        for name, pose in poses.items():
            off_m = np.linalg.norm(left[:, first : first + 3], axis=1)
            first += 6 if pose.shape[1] == 7 else 3
            moved_m = np.linalg.norm(np.ptp(pose[rows, :3], axis=0))
            rms_m = float(np.sqrt((off_m**2).mean()))
            if rms_m > max(_LARGEST_RESIDUAL_SHARE * float(moved_m), 1e-4):
                raise RecordingError(
                    f"pose.{name} cannot be reached: the nearest postures are off by "
                    f"{1e3 * rms_m:.3g} mm (RMS); it must be that of the model's frame {name}, in "
                    "the axes of its base, in m"
                )
            worst_mm = max(worst_mm, 1e3 * rms_m)
        named = some_of([self._robot.joint_names[joint] for joint in sought], 6)
        of_poses = some_of([f"pose.{name}" for name in poses])
        sentences = [
            f"Positions of {named} are those that make {of_poses}, by inverse kinematics, which "
            f"leaves {worst_mm:.2g} mm (RMS)."
        ]
        if several:
            sentences.append(
                "Several postures make the first poses; the nearest to the model's own is taken."
            )
        return sentences
