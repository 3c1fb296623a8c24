"""Arm files, changed as text, as bytes and as trees."""

from __future__ import annotations

import math
import random
from pathlib import Path

from cablesense_sim.arm import load_arm, parse_arm
from cablesense_sim.arm_files import bundled_arms, find_arm
from cablesense_sim.mechanism import Mechanism
from fuzz.file_item import file_run
from fuzz.target import FalseAnswerError, Run
from fuzz.text_mutation import mutated_text
from fuzz.tree_mutation import mutated_yaml

_EFFECTS = """
effects:
  - {effect: payload, at: segment_2, parameters: {mass_kg: 0.3}}
  - {effect: sensor_gain, at: cable_3, parameters: {gain: 1.02}}
"""


def make_arms(seed: int) -> Run:
    """Of the bundled arms, and of one with effects."""
    texts = [find_arm(name).read_text(encoding="utf-8") for name in bundled_arms()]
    texts.append(texts[0] + _EFFECTS)

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        text = rng.choice(texts)
        changed = mutated_yaml(rng, text) if item % 2 else mutated_text(rng, text, texts)
        return changed, ".yaml"

    return file_run("arms", seed, make, _use)


def _use(path: Path) -> None:
    arm = load_arm(path)
    if parse_arm(path.read_text(encoding="utf-8-sig")).identity != arm.identity:
        raise FalseAnswerError("the same text is two arms")
    Mechanism.from_arm(arm)
    numbers = [arm.cables.pretension_n, arm.segments.plate_offset_m, *arm.gravity_m_s2]
    if not all(math.isfinite(number) for number in numbers):
        raise FalseAnswerError(f"an arm with {numbers}")
