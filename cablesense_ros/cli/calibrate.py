"""`cablesense calibrate`: from unloaded poses of a recording, what is known of a machine."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cablesense_base import CableSenseError
from cablesense_base.files import output_file
from cablesense_contact.felt_arm import FeltArm
from cablesense_ros.cli.options import (
    ColumnsOption,
    ForceOption,
    JsonOption,
    TopicsOption,
    print_json,
    print_notes,
    titled_table,
)
from cablesense_sim.machine.description import is_machine_file

if TYPE_CHECKING:
    from rich.table import Table

    from cablesense_contact.calibration import Calibration
    from cablesense_contact.felt import FeltMachine
    from cablesense_contact.law import Law
    from cablesense_contact.reference_contacts import ReferenceContacts
    from cablesense_recording.layout import Described
    from cablesense_sim.arm import Arm
    from cablesense_sim.parameter_groups import GroupedParameters

Description = dict[str, Any]
_SHOWN_UNITS = {"1": (100.0, "%"), "m": (1e3, "mm"), "rad": (57.29577951308232, "°")}
"""Factor and unit in tables; others are as they are."""


def calibrate(
    recording: Annotated[
        Path, typer.Argument(help="A .csv file, a .mcap file or a rosbag2 folder.")
    ],
    out: Annotated[Path, typer.Option(help="The calibration file to write.")],
    arm: Annotated[
        str,
        typer.Option(
            help="Arm of the recording: a path, or the name of a bundled one; or a machine file."
        ),
    ] = "cdsm",
    model: Annotated[
        str,
        typer.Option(
            help="Model file of contacts anywhere for this arm or machine.",
            show_default="the arm's own, or its law in PyTorch; of a machine the one beside it",
        ),
    ] = "",
    ended: Annotated[
        datetime | None,
        typer.Option(
            help="When the recording ended, UTC: from then on sensors drift.",
            show_default="the time of its file",
        ),
    ] = None,
    columns: ColumnsOption = None,
    topic: TopicsOption = None,
    force: ForceOption = False,
    json_output: JsonOption = False,
) -> None:
    """Find how an arm or machine differs from its file, from the unloaded poses of a recording.

    Takes every stay of a second or more at one command, or at one pose of measured joints, without
    a load. Twenty-five poses within 10 degrees make a good calibration; the node commissioner
    chooses better ones, and visits them by itself. Writes the file that the estimator takes as its
    parameter calibration_file.

    Example: cablesense calibrate poses.mcap --arm my_arm.yaml --out my_arm.calibration
    """
    from dataclasses import replace

    from rich.console import Console

    from cablesense_contact.calibration import Calibrator
    from cablesense_contact.calibration_file import write_calibration
    from cablesense_contact.unloaded_holds import unloaded_holds, with_held_positions
    from cablesense_recording.column_map import read_column_map
    from cablesense_recording.reading import read_recording

    output_file(out, force=force, inputs=(recording, arm, model, columns))
    machine = opened(arm, model)
    felt = machine.felt
    named = None if columns is None else read_column_map(columns, machine.described)
    recorded = read_recording(recording, machine.described, topic or (), named)
    if felt.reads_joints:
        recorded = with_held_positions(recorded)
    unloaded = unloaded_holds(recorded, _ended_ns(recording, ended))
    calibration = Calibrator(felt, machine.law).from_poses(unloaded)
    poses = len({reading.command_rad.tobytes() for reading in unloaded})
    many = "1 pose" if poses == 1 else f"{poses} poses"
    made_from = f"{recorded.name}, with unloaded readings in {many}"
    calibration = replace(calibration, made_from=made_from)
    write_calibration(out, calibration, felt)
    description = calibration_description(calibration, felt.parameters, machine)
    print_notes(recorded.notes, json_output)
    if json_output:
        print_json({"file": str(out), **description})
        return
    console = Console()
    print_calibration(console, description)
    console.print(
        f"{out}: give it to the estimator as -p calibration_file:={out}",
        soft_wrap=True,
        markup=False,
    )


class Opened(NamedTuple):
    """A machine with its law, as a calibration takes it.

    Attributes:
        felt: the machine.
        law: its law.
        contacts: finds it under pushes.
        described: what recordings of it are read by.
    """

    felt: FeltMachine
    law: Law
    contacts: Callable[[], ReferenceContacts]
    described: Described


def opened(arm: str, model: str = "") -> Opened:
    """An arm or a machine by name or path, with a law for it.

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another machine.
        ModuleNotFoundError: no model file of an arm fits, and PyTorch is not installed.
    """
    if is_machine_file(arm):
        from cablesense_online.machine_models import load_machine

        loaded = load_machine(arm, model)
        return Opened(loaded.machine, loaded.law, loaded.reference_contacts, loaded.described)
    from cablesense_sim.arm import open_arm

    described = open_arm(arm)
    return opened_arm(described, law_of(described, arm, model))


def opened_arm(arm: Arm, law: Law) -> Opened:
    """An arm with a law for it."""
    from cablesense_contact.reference_contacts import ReferenceContacts

    return Opened(FeltArm(arm), law, partial(ReferenceContacts.of_arm, arm), arm)


def law_of(arm: Arm, arm_file: str, model: str = "") -> Law:
    """The law of an arm: from a model file, the arm's bundled one, or else in PyTorch.

    Raises:
        ModelFileError: a model file is given and does not fit.
        ModuleNotFoundError: no model file fits, and PyTorch is not installed.
    """
    from cablesense_contact.errors import ModelFileError
    from cablesense_contact.inference.law_model import LawModel
    from cablesense_contact.inference.metadata import find_model_of

    try:
        return LawModel(find_model_of(arm, arm_file, model), arm)
    except ModelFileError:
        if model:
            raise
    from cablesense_training.law.build import TorchLaw

    return TorchLaw(arm)


def calibration_description(
    calibration: Calibration, parameters: GroupedParameters, machine: Opened | None
) -> Description:
    """What a calibration says, as plain values in SI units.

    Without the machine nothing is said of how well forces are known.
    """
    from dataclasses import asdict

    from cablesense_contact.calibration_summary import summarised

    unloaded = calibration.unloaded
    taken_ns = calibration.last_unloaded_ns
    taken = (
        datetime.fromtimestamp(taken_ns / 1e9, UTC).replace(microsecond=0) if taken_ns else None
    )
    return {
        "kind": "calibration",
        "arm": calibration.arm_identity,
        "made_from": calibration.made_from,
        "poses": len({reading.command_rad.tobytes() for reading in unloaded}),
        "unloaded_readings": len(unloaded),
        "taken": taken.isoformat() if taken else None,
        "chi2": calibration.chi2,
        "channels": sum(len(reading.reading_n) for reading in unloaded),
        "probability": calibration.misfit_probability,
        "as_described": calibration.as_described,
        "force_known_n": None if machine is None else _force_known_n(calibration, machine),
        "parameters": [asdict(row) for row in summarised(calibration, parameters)],
    }


def print_calibration(console: Any, description: Description) -> None:
    """Print what `calibration_description` gives: some sentences and a table."""

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, markup=False, highlight=False)

    say(f"Calibration of {description['arm']}, from {description['made_from']}")
    if description["taken"]:
        say(f"taken {description['taken']}")
    console.print(_table(description))
    say(
        f"χ² {description['chi2']:.0f} of {description['channels']} readings: probability "
        f"{description['probability']:.2g}"
    )
    if description["as_described"]:
        say("It is as its file's tolerances describe it.")
    else:
        say(
            "It is not as its file's tolerances describe it: was it touched, is a load not in the "
            "recording, or is it built less well? Larger tolerances in its file make its "
            "intervals true"
        )
    known = description["force_known_n"]
    if known:
        say(
            f"A push of {known['push']:g} N is known to ± {known['after']:.2g} N (95 %); by the "
            f"tolerances alone to ± {known['before']:.2g} N"
        )


def _force_known_n(calibration: Calibration, machine: Opened) -> Description | None:
    """To what the force of a push is known, in another pose than those of the calibration.

    None where the machine does not bear such a push.
    """
    from cablesense_contact.calibration import Calibrator

    law = machine.law
    try:
        contacts = machine.contacts()
    except CableSenseError:
        return None
    before = contacts.known_force(law, calibration.prior_mean, calibration.prior_covariance)
    elsewhere = Calibrator(machine.felt, law).moved(calibration)
    after = contacts.known_force(law, elsewhere.mean, elsewhere.covariance)
    return {"push": after.push_n, "before": before.half_interval_n, "after": after.half_interval_n}


def _table(description: Description) -> Table:
    headings = ("tolerance", "known to", "determined", "farthest from the file")
    rows = []
    for row in description["parameters"]:
        factor, unit = _SHOWN_UNITS.get(row["unit"], (1.0, row["unit"]))
        rows.append(
            (
                row["kind"].replace("_", " "),
                f"{factor * row['tolerance']:.3g} {unit}",
                f"{factor * row['std']:.3g} {unit}",
                f"{row['determined']} of {row['count']}",
                f"{row['largest']:.1f} tolerances",
            )
        )
    title = "One standard deviation each, medians of a kind"
    return titled_table(title, "parameters", *headings, right=headings, rows=rows)


def _ended_ns(recording: Path, ended: datetime | None) -> int:
    """When a recording ended, since the epoch: as given, or when its newest file was written."""
    if ended is not None:
        return round(1e9 * ended.replace(tzinfo=ended.tzinfo or UTC).timestamp())
    files = [file for file in recording.iterdir() if file.is_file()] if recording.is_dir() else []
    return max(file.stat().st_mtime_ns for file in files or [recording])
