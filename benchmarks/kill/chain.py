"""The chain under test: sim, amplifiers, driver, estimator and a recorder, each a process."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from nodes.node_process import NodeProcess, node_command

STALE_AFTER_S = 0.05
VICTIMS = ("driver", "sim", "estimator")
_UP_LINES = {
    "driver": r"\[INFO\] \[([\d.]+)\] \[can_driver\]: arm ",
    "sim": r"\[INFO\] \[([\d.]+)\] \[sim\]: arm ",
    "estimator": r"\[INFO\] \[([\d.]+)\] \[estimator\]: arm .*: configured",
}


class Chain:
    """All processes; each can be killed and started again by its name."""

    def __init__(self, arm: str, rate_hz: float, folder: Path) -> None:
        """The sim takes samples at `rate_hz`; logs and files go to `folder`."""
        link = folder / "adapter"
        self.recording = folder / "kills.mcap"
        commands = {
            "sim": node_command(
                "sim_node",
                {"arm": arm, "rate_hz": float(rate_hz)},
                {"cable_tensions": "simulated_tensions"},
            ),
            "amplifiers": node_command("can_emulator_node", {"arm": arm, "channel": link}),
            "driver": node_command(
                "can_driver_node",
                {
                    "arm": arm,
                    "interface": "slcan",
                    "channel": link,
                    "bitrate_bit_s": 1_000_000,
                    "stale_after_s": STALE_AFTER_S,
                },
            ),
            "estimator": node_command(
                "estimator_node",
                {
                    "arm": arm,
                    "stale_after_s": STALE_AFTER_S,
                    "state_file": folder / "estimator_state.json",
                },
            ),
            "recorder": recorder_command(self.recording),
        }
        self.processes = {
            name: NodeProcess(name, command, folder / f"{name}.log")
            for name, command in commands.items()
        }

    def pids(self) -> dict[str, int]:
        """Process ids of those that live."""
        return {name: one.pid for name, one in self.processes.items() if one.alive}

    def up_epoch_s(self, victim: str) -> float:
        """When a victim last said that it was set up, s since the epoch; NaN before the first."""
        said = re.findall(_UP_LINES[victim], self.processes[victim].log())
        return float(said[-1]) if said else float("nan")

    def ups(self, victim: str) -> int:
        """How often it said so."""
        return len(re.findall(_UP_LINES[victim], self.processes[victim].log()))

    def end(self) -> dict[str, int]:
        """End all; exit codes by name. The recorder goes first, so that its file is whole."""
        order = sorted(self.processes, key=lambda name: name != "recorder")
        return {name: self.processes[name].stop() for name in order}


def recorder_command(file: Path) -> list[str]:
    """The command that records the running nodes into a file."""
    run = "import sys; from cablesense_ros.cli.app import main; sys.exit(main())"
    return [sys.executable, "-c", run, "record", "--out", str(file)]
