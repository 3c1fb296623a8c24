"""Tendons over guides as elastic cable in pieces, which sticks and slips from piece to piece.

Between two guides lies one piece. Each step, cable passes a guide from the looser piece to the
tighter one until their tensions are apart by Euler's ratio at most, guide after guide, until no
more passes; beyond the last guide it is held. The piece before the first has the motor's tension.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from cablesense_base import Array

PRETENSION_N = 2.0
_STIFF_N_M = 2e4
"""Of a piece: some 5 N/mm for a whole tendon."""
_SWEEPS, _CLOSE_N = 40, 1e-3


@dataclass(frozen=True)
class TendonGuides:
    """Of K tendons, P points each, of a robot whose N joints all turn about y.

    Attributes:
        link: (K, P) which each point is on, 0 the base's.
        place_m: (K, P, 2) there, x and z.
        origin_m: (N, 2) of each joint on the link before.
    """

    link: Array
    place_m: Array
    origin_m: Array

    def pose(self, angle: Array) -> tuple[Array, Array]:
        """Points (B, K, P, 2) and joints (B, N, 2) in base axes, at angles (B, N)."""
        turned = np.cumsum(np.pad(angle, ((0, 0), (1, 0))), axis=1)
        cos, sin = np.cos(turned), np.sin(turned)
        frame = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)
        steps = np.einsum("bnij,nj->bni", frame[:, :-1], self.origin_m)
        joints = np.cumsum(steps, axis=1)
        origin = np.concatenate([np.zeros_like(joints[:, :1]), joints], axis=1)
        points = origin[:, self.link] + np.einsum(
            "bkpij,kpj->bkpi", frame[:, self.link], self.place_m
        )
        return points, joints

    def torques_n_m(self, pose: tuple[Array, Array], tension_n: Array) -> Array:
        """(B, K, N) of each tendon about each joint, of tensions (B, K, P - 1) in its pieces."""
        points, joints = pose
        piece = np.diff(points, axis=2)
        pull = tension_n[..., None] * piece / np.linalg.norm(piece, axis=-1, keepdims=True)
        force = np.pad(pull, ((0, 0), (0, 0), (0, 1), (0, 0)))
        force[:, :, 1:] -= pull
        arm = points[:, :, :, None] - joints[:, None, None]
        about_y = arm[..., 1] * force[..., None, 0] - arm[..., 0] * force[..., None, 1]
        carried = self.link[..., None] > np.arange(joints.shape[1])
        return np.asarray((about_y * carried).sum(2))

    def moments_m(self, angle: Array) -> Array:
        """(B, K, N) torque by tension without friction."""
        points, _ = pose = self.pose(angle)
        return self.torques_n_m(pose, np.ones((*points.shape[:2], points.shape[2] - 1)))


class Rubbing:
    """The cable of B robots, and how it lies now."""

    def __init__(self, guides: TendonGuides, friction: Array, angle: Array) -> None:
        """`friction` (B, K) of each tendon with its guides; at angles (B, N) at first."""
        self._guides, self._friction = guides, friction
        points, _ = guides.pose(angle)
        length = np.linalg.norm(np.diff(points, axis=2), axis=-1)
        self._natural_m = length - PRETENSION_N / _STIFF_N_M

    def lost_n_m(self, angle: Array, torque_n_m: Array) -> Array:
        """(B, N) loss of the motors' torques, on the way to angles (B, N)."""
        points, _ = pose = self._guides.pose(angle)
        piece = np.diff(points, axis=2)
        length = np.linalg.norm(piece, axis=-1)
        way = piece / length[..., None]
        turn = np.arccos(np.clip((way[:, :, 1:] * way[:, :, :-1]).sum(-1), -1.0, 1.0))
        most = np.exp(self._friction[..., None] * turn)
        tension = _STIFF_N_M * (length - self._natural_m)
        tension[..., 0] = pulls_n(self._guides.moments_m(angle), torque_n_m)
        self._natural_m += tension / _STIFF_N_M
        rubs = self._friction > 0.0
        tension[~rubs] = tension[~rubs][:, :1]
        tension[rubs] = _settled(tension[rubs], most[rubs])
        self._natural_m -= tension / _STIFF_N_M
        return np.asarray(torque_n_m - self._guides.torques_n_m(pose, tension).sum(1))


def _settled(tension_n: Array, most: Array) -> Array:
    """Tensions (C, P - 1) of which neighbours differ by a factor of `most` (C, P - 2) at most."""
    pieces, low = tension_n.T.copy(), 1.0 / most.T
    for _ in range(_SWEEPS):
        before = pieces.copy()
        for n in range(1, len(pieces)):
            near, far = pieces[n - 1], pieces[n]
            ratio = np.minimum(np.maximum(near / far, low[n - 1]), most[:, n - 1])
            if n == 1:  # the motor holds what lies before
                pieces[n] = near / ratio
            else:
                passed = (near - ratio * far) / (1.0 + ratio)
                pieces[n - 1], pieces[n] = near - passed, far + passed
        if np.abs(pieces - before).max(initial=0.0) < _CLOSE_N:
            break
    return np.maximum(pieces.T, 1e-3)


def pulls_n(moment_m: Array, torque_n_m: Array) -> Array:
    """Tensions (…, K) of a pair of tendons for each joint, the last joint's first.

    They make torques (…, N) by moments (…, K, N), and none is below the pretension.
    """
    left = torque_n_m.copy()
    pulls = np.full(moment_m.shape[:-1], PRETENSION_N)
    for joint in reversed(range(left.shape[-1])):
        pair = slice(2 * joint, 2 * joint + 2)
        left = left - PRETENSION_N * moment_m[..., pair, :].sum(-2)
        for tendon in (2 * joint, 2 * joint + 1):
            more = np.maximum(left[..., joint] / moment_m[..., tendon, joint], 0.0)
            pulls[..., tendon] += more
            left = left - more[..., None] * moment_m[..., tendon, :]
    return pulls


def read_guides(path: str | Path) -> TendonGuides:
    """The tendons of one of these MJCFs; short ones have points more on their first piece."""
    model = mujoco.MjModel.from_xml_path(str(path))
    most, links, places = int(model.tendon_num.max()), [], []
    for first, count in zip(model.tendon_adr, model.tendon_num, strict=True):
        sites = model.wrap_objid[first : first + count]
        link, place = model.site_bodyid[sites].tolist(), list(model.site_pos[sites][:, [0, 2]])
        missing = most - count
        between = (np.arange(missing) + 1.0) / (missing + 1.0)
        links.append([link[0]] * missing + link)
        place[1:1] = [place[0] + share * (place[1] - place[0]) for share in between]
        places.append(place)
    return TendonGuides(np.array(links), np.array(places), model.body_pos[1:][:, [0, 2]])
