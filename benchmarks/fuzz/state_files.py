"""State files of an estimator, and whether one goes on from what they say."""

from __future__ import annotations

import json
import random
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from cablesense_msgs_py.journal import JournalEntry
from cablesense_ros.estimation import Estimation
from cablesense_ros.estimation_settings import EstimationSettings
from cablesense_ros.state_file import StateFile
from cablesense_sim.arm_files import open_arm
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.model_files import find_model
from fuzz.file_item import file_run
from fuzz.target import FalseAnswerError, Run
from fuzz.text_mutation import mutated_text
from fuzz.tree_mutation import VALUES

_SETTINGS = EstimationSettings(0.5, 0.2, 1.0, 5, 1.0, True, 0.35, 0.5)


def make_states(seed: int) -> Run:
    """A state that was written, changed as text or in one of its values."""
    arm = open_arm("cdsm")
    estimator = Estimator.load(find_model("cdsm"), arm)
    straight = np.zeros(arm.joint_count)
    at_rest = tuple(solve_equilibrium(Mechanism.from_arm(arm), straight).tensions_n.tolist())
    nothing = tuple(straight.tolist())
    entry = JournalEntry(
        before_ns=10**18,
        events=(),
        arm=arm.identity,
        settings={},
        command_rad=nothing,
        lowest_rad=nothing,
        highest_rad=nothing,
        rest_from_ns=0,
        unloaded_n=at_rest,
        tared_n=at_rest,
        tare_command_rad=nothing,
    )
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "state.json"
        state = StateFile(whole, 60.0)
        state.keep(replace(entry, before_ns=10**18 + 1))
        state.flush()
        text = whole.read_text(encoding="utf-8")

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        if item % 2:
            return mutated_text(rng, text), ".json"
        values = json.loads(text)
        key = rng.choice(list(values))
        if isinstance(values[key], list) and rng.random() < 0.6:
            values[key][rng.randrange(len(values[key]))] = rng.choice(VALUES)
        else:
            values[key] = rng.choice(VALUES)
        return json.dumps(values).encode("utf-8", errors="surrogatepass"), ".json"

    def use(path: Path) -> None:
        found = StateFile(path, 60.0).read(arm.identity)
        if found is None:
            raise FalseAnswerError("a file that is there was taken for none")
        estimation = Estimation(arm, estimator, _SETTINGS, 0.0)
        estimation.restore(found)
        unloaded = estimation.tare.unloaded_n
        if unloaded is None or not np.isfinite(unloaded).all():
            raise FalseAnswerError(f"unloaded tensions {unloaded}")

    return file_run("states", seed, make, use)
