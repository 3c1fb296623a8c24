"""A small recording for tests of the diagnosis: load cycles, a sweep, a bent pose; no physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from blind_sets import narrow_arm

from cablesense_gap.experiments import Experiment
from cablesense_recording.recording import Recording

LAB = narrow_arm("cdsm_lab")
RATE_HZ = 5.0
CYCLE = np.repeat([0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0], 4)


def small_recording(peak_n: float = 40.0) -> Recording:
    """Rest; a cycle on each segment straight and bent; one sweep of joint 2; all tensions 50 N."""
    bent = np.zeros(8)
    bent[4] = 0.1
    trials = [(np.zeros((20, 8)), 0, np.zeros(20))]
    for pose in (np.zeros(8), bent):
        trials += [(np.tile(pose, (len(CYCLE), 1)), n, peak_n * CYCLE) for n in range(1, 5)]
    sweep = np.zeros((60, 8))
    sweep[:, 2] = 0.12 * np.sin(np.linspace(0.0, 2.0 * np.pi, 60))
    trials.append((sweep, 0, np.zeros(60)))
    load = np.concatenate([size for *_, size in trials])
    segment = np.repeat([n for _, n, _ in trials], [len(size) for *_, size in trials])
    rows = len(load)
    return Recording(
        name="small",
        time_s=np.arange(rows) / RATE_HZ,
        trial=np.repeat(np.arange(len(trials)), [len(size) for *_, size in trials]),
        command_rad=np.concatenate([command for command, *_ in trials]),
        load_segment=np.where(load > 0.0, segment, 0),
        load_n=np.outer(load, [0.0, 0.0, -1.0]),
        tensions_n=np.full((rows, 12), 50.0),
    )


def propose_no_experiment(monkeypatch):
    """Diagnoses of arms end without a proposal, for which 43 blocks would be simulated."""
    monkeypatch.setattr(
        "cablesense_gap.arm_system.next_experiment",
        lambda *_, **__: Experiment("No experiment is proposed."),
    )


PLACES_M = np.array([0.03, 0.065, 0.115])
"""Near the joint, at the contact point of the arm file, and far out."""


def placed_recording(peak_n: float = 40.0) -> Recording:
    """`small_recording` with the loads of one trial after the other at three places in turn."""
    made = small_recording(peak_n)
    at_m = np.where(made.load_segment > 0, PLACES_M[made.trial % 3], np.nan)
    return replace(made, load_at_m=at_m)
