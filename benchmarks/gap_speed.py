"""Time and memory of one diagnosis, and of `mujoco.sysid` on the same recording.

    pip install absl-py colorama tabulate     # what mujoco.sysid imports and this project does not
    python benchmarks/gap_speed.py [--seed 7] [--hidden cable_creep] [--write]

The diagnosis runs as a user runs it, in a process of its own with two workers. `mujoco.sysid`
fits one candidate after the other, each chosen and written down here by hand, since it neither
chooses nor has what does not fit into a MuJoCo model. It gets the cheapest simulation that
MuJoCo offers: every distinct row once, as a rest, by steps so long that each is one of Newton's.
Rows where the arm has more than one place to rest count in neither.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import harness
import mujoco
import numpy as np
from gap_blind import ARM, drawn

from cablesense_base import Array
from cablesense_gap.arm_simulator import has_one_equilibrium
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.verdict import read_verdict
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.model import build_spec

os.environ.setdefault("OMP_NUM_THREADS", "1")
sysid = importlib.import_module("mujoco.sysid")  # where it is imported, mypy wants mujoco typed

RESULT = "gap_speed.json"
WORKERS = 2
STEP_S = 0.02
"""So long that inertia is next to nothing, and short enough that no cable overshoots its slack."""
MOST_STEPS = 60
AT_REST_RAD = 1e-7
DIFF_STEP = 1e-3
"""The default step of the differences stalls, as contacts and slack make them rough."""

NOT_IN_A_MODEL = {
    "capstan_friction": "frictionloss creeps at rest; a loop that holds has no attribute",
    "joint_friction": "frictionloss creeps at rest; a loop that holds has no attribute",
    "cable_creep": "tendons are not history-dependent",
    "actuator_backlash": "needs code of one's own between command and actuator",
    "sensor_gain": "by sysid.apply_gain in a residual of one's own",
    "sensor_offset": "by sysid.apply_bias in a residual of one's own",
    "sensor_lag": "sysid.apply_delay delays, but does not smooth",
    "sensor_drift": "no signal modifier",
    "sensor_crosstalk": "no signal modifier",
}

Writer = Callable[[Any, int, float], None]
"""Writes the value of a parameter for the place of an index to a spec."""


def main() -> None:
    """Makes the recording, diagnoses it, fits it, prints; keeps the numbers with `--write`."""
    parser = harness.parser(__doc__, f"results/{RESULT}")
    parser.add_argument("--seed", type=int, default=7, help="of the plant")
    parser.add_argument("--hidden", default="cable_creep", help="what is hidden in the recording")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        answer = drawn(folder, 1, options.seed, (options.hidden,))["case_001"]
        recording = read_recording(folder / "case_001.csv", open_arm(ARM))
        result = {
            **harness.origin(),
            "load_average_before": [round(load, 1) for load in os.getloadavg()],
            "rows": len(recording),
            "hidden": {key: getattr(answer, key) for key in ("effects", "where", "form")}
            | {"gap_n": f"{answer.gap_n:.4f}"},
            "diagnosis": _diagnosed(folder / "case_001.csv", folder / "out"),
            "mujoco_sysid": _fitted(recording),
        }
    harness.publish(RESULT, result, options)


def _diagnosed(recording: Path, out: Path) -> dict[str, Any]:
    """Wall seconds and peak memory of the verb, all of its processes together."""
    command = [*harness.CABLESENSE, "gap", "diagnose", str(recording), "--arm", ARM]
    command += ["--out", str(out), "--workers", str(WORKERS)]
    seconds, peak_mb = harness.run_watched(command)
    verdict = read_verdict(out / "verdict.json")
    return {
        "workers": WORKERS,
        "seconds": round(seconds, 1),
        "peak_memory_mb": round(peak_mb),
        "candidates": len(verdict.candidates),
        "effects": list(verdict.effects),
        "probability": round(verdict.probability, 3),
        "gap_before_n": round(verdict.gap.before_n, 4),
        "gap_after_n": round(verdict.gap.after_n, 4),
        "gap_floor_n": round(verdict.gap.floor_n, 4),
    }


def _fitted(recording: Recording) -> dict[str, Any]:
    """Every candidate that a MuJoCo model can express, fitted by sysid to all rows."""
    arm = open_arm(ARM)
    mechanism = mechanism_of(arm)
    rests = _Rests(recording, mechanism)
    found = {}
    began = time.monotonic()
    for name, ((low, high, first), kind, count, write) in _candidates(mechanism).items():
        start = time.monotonic()
        rests.calls = 0
        parameters = sysid.ParameterDict()
        places = ["pitch", "roll"] if kind == "axis" else [f"{kind}_{i + 1}" for i in range(count)]
        for i, place in enumerate(places):
            modifier = partial(_modify, write=write, index=i)
            parameters.add(sysid.Parameter(place, first, low, high, modifier=modifier))
        residual = rests.residual_of(build_spec(mechanism, arm.name))
        _, fit = sysid.optimize(
            parameters,
            residual,
            optimizer="scipy",
            verbose=False,
            diff_step=DIFF_STEP,
            x_scale=high / 3.0,
            max_iters=12,
        )
        left = residual(fit.x, parameters)[0][0]
        found[name] = {
            "parameters": count,
            "seconds": round(time.monotonic() - start, 1),
            "simulations": rests.calls,
            "residual_n": round(float(np.sqrt((left**2).mean())), 4),
            "values": {k: round(float(v), 6) for k, v in zip(places, fit.x, strict=True)},
        }
        print(f"sysid {name}: {found[name]}", file=sys.stderr)
    return {
        "simulated_rows": rests.count,
        "residual_nominal_n": round(rests.nominal_n, 4),
        "seconds": round(time.monotonic() - began, 1),
        "optimizer": f"scipy, diff_step {DIFF_STEP}, threads 1",
        "candidates": found,
        "not_expressible": NOT_IN_A_MODEL,
    }


def _modify(spec: Any, parameter: Any, write: Writer, index: int) -> None:
    write(spec, index, parameter.value[0])


class _Rests:
    """The recording's distinct rows, and a residual for sysid: each row a rest of the model."""

    def __init__(self, recording: Recording, mechanism: Mechanism) -> None:
        flat = np.concatenate(
            [recording.command_rad, recording.forces_n.reshape(len(recording), -1)], axis=1
        )
        _, self._first, self._same = np.unique(
            flat, axis=0, return_index=True, return_inverse=True
        )
        # neighbours in time rest near each other
        order = np.argsort(self._first)
        self._first, self._same = self._first[order], np.argsort(order)[self._same]
        self.count = len(self._first)
        self.calls = 0
        self._forces_n = recording.forces_n[self._first]
        self._held_m = held_lengths_m(mechanism, recording.command_rad[self._first])
        self._measured = recording.tensions_n
        self._run_m = mechanism.run_m
        nominal = self._rests_n(build_spec(mechanism).compile())[self._same]
        self._used = has_one_equilibrium(nominal, open_arm(ARM))
        self.nominal_n = float(np.sqrt(((nominal - self._measured)[self._used] ** 2).mean()))

    def residual_of(self, spec: mujoco.MjSpec) -> Callable[..., tuple[list[Array], None, None]]:
        """The function that `sysid.optimize` takes, in newtons; x is (K,) or (K, B)."""

        def residual(x: Array, parameters: Any) -> tuple[list[Array], None, None]:
            columns = []
            for values in np.asarray(x).reshape(len(x), -1).T:
                parameters.update_from_vector(values)
                model = sysid.apply_param_modifiers(parameters, spec)
                left = self._rests_n(model)[self._same] - self._measured
                columns.append(left[self._used].ravel())
            stacked = np.stack(columns, axis=-1)
            return [stacked[:, 0] if np.ndim(x) == 1 else stacked], None, None

        return residual

    def _rests_n(self, model: mujoco.MjModel) -> Array:
        """Tensions (D, M) of the distinct rows."""
        self.calls += 1
        model.opt.timestep = STEP_S
        data = mujoco.MjData(model)
        segments = range(1, self._forces_n.shape[1] + 1)
        bodies = np.array([model.body(f"segment_{n}").id for n in segments])
        sites = np.array([model.site(f"contact_{n}").id for n in segments])
        tensions = np.empty((self.count, model.ntendon))
        for row in range(self.count):
            data.mocap_pos[:, 0] = -self._run_m + self._held_m[row]
            for _ in range(MOST_STEPS):
                before = data.qpos.copy()
                arms = data.site_xpos[sites] - data.xipos[bodies]
                data.xfrc_applied[bodies, :3] = self._forces_n[row]
                data.xfrc_applied[bodies, 3:] = np.cross(arms, self._forces_n[row])
                data.qvel[:] = 0.0
                mujoco.mj_step(model, data)
                if np.abs(data.qpos - before).max() < AT_REST_RAD:
                    break
            mujoco.mj_kinematics(model, data)
            mujoco.mj_tendon(model, data)
            stretch = data.ten_length - model.tendon_lengthspring[:, 1]
            stiffness = model.tendon_stiffness.reshape(model.ntendon, -1)[:, 0]
            tensions[row] = np.maximum(stiffness * stretch, 0.0)
        return tensions


def _candidates(
    mechanism: Mechanism,
) -> dict[str, tuple[tuple[float, float, float], str, int, Writer]]:
    """By the library's names: range and start, kind and number of the places, writer."""
    gravity = float(np.linalg.norm(mechanism.gravity_m_s2))
    straight_m = mechanism.pretension_n / mechanism.stiffness_n_m
    lengths = build_spec(mechanism).compile().tendon_lengthspring[:, 1] + straight_m
    segments, cables = mechanism.segment_count, mechanism.cable_count

    def mass(spec: Any, n: int, value: float) -> None:
        spec.body(f"segment_{n + 1}").mass = mechanism.mass_kg[n] + value

    def tilt(spec: Any, axis: int, value: float) -> None:
        spec.option.gravity[axis] = gravity * np.sin(value)

    def stiffness(spec: Any, n: int, value: float) -> None:
        for i in np.flatnonzero(mechanism.cable_segment == n + 1):
            k = mechanism.cable_stiffness_n_m[i] * (1.0 + value)
            cable = spec.tendon(f"cable_{i + 1}")
            cable.stiffness = [k, 0.0, 0.0]
            cable.springlength = [0.0, lengths[i] - mechanism.pretension_n[i] / k]

    def pretension(spec: Any, i: int, value: float) -> None:
        rest = lengths[i] - straight_m[i] - value / mechanism.stiffness_n_m[i]
        spec.tendon(f"cable_{i + 1}").springlength = [0.0, rest]

    def elasticity(spec: Any, n: int, value: float) -> None:
        for axis in ("pitch", "yaw"):
            spec.joint(f"joint_{n + 1}_{axis}").stiffness = [value, 0.0, 0.0]

    def contact(spec: Any, n: int, value: float) -> None:
        spec.site(f"contact_{n + 1}").pos = [mechanism.contact_m[n] + value, 0.0, 0.0]

    return {
        "payload": ((-0.4, 3.0, 0.1), "segment", segments, mass),
        "base_tilt": ((-0.5, 0.5, 0.01), "axis", 2, tilt),
        "cable_stiffness": ((-0.8, 3.0, 0.05), "segment", segments, stiffness),
        "pretension_error": ((-40.0, 100.0, 0.5), "cable", cables, pretension),
        "joint_elasticity": ((0.0, 100.0, 1.0), "joint", segments, elasticity),
        "contact_offset": ((-0.06, 0.06, 0.002), "segment", segments, contact),
    }


if __name__ == "__main__":
    main()
