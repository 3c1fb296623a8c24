"""Any recording with a defect, in CSV and bags of arms and robots: it is named or harmless."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import wrong_columns
from cablesense_recording.checks import check_recording
from cablesense_recording.reading import read_recording as read_arm
from cablesense_recording.recording import RecordingError
from cablesense_sim.replay import replay_arm
from tests.helpers.defective_recordings import (
    ARM_TENSIONS,
    DEFECTS,
    LAB,
    arm_table,
    robot_table,
    write_arm_bag,
    write_arm_csv,
    write_robot_bag,
    write_robot_csv,
)
from tests.helpers.two_link import write_model

pytestmark = pytest.mark.slow  # writes and reads thousands of messages

EXAMPLES = settings(
    max_examples=2, deadline=None, derandomize=True, database=None, phases=(Phase.generate,)
)
SEEDS = st.integers(0, 2**31)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("defects")


@pytest.fixture(scope="module")
def robot(folder):
    return load_robot(write_model(folder))


@pytest.fixture(scope="module")
def tables(folder):
    return {"robot": robot_table(folder), "arm": arm_table()}


def said_of_robot(path, robot):
    """What is said of a recording by its reader, by the model, and its numbers."""
    recording = read_robot_recording(path, robot)
    numbers = np.column_stack([recording.position, recording.torque])

    def said_by_model():
        prepared(recording, robot)
        return " ".join(wrong_columns(recording, robot))

    return " ".join([*recording.notes, *recording.warnings]), said_by_model, numbers


def said_of_arm(path, _):
    recording = read_arm(path, LAB)
    numbers = np.column_stack([recording.command_rad, recording.tensions_n])
    findings = check_recording(recording, LAB)

    def said_by_model():
        nominal_n = replay_arm(LAB, recording.course)
        return " ".join(finding.text for finding in check_recording(recording, LAB, nominal_n))

    texts = [finding.text for finding in findings]
    return " ".join([*recording.notes, *texts]), said_by_model, numbers


def nearest(numbers, sound):
    """(R,) how far each row is from the nearest one of the sound recording."""
    return cKDTree(sound).query(np.nan_to_num(numbers, nan=1e9))[0]


def numbers_of(table):
    places = [name for name in table if name.startswith(("position", "q"))]
    sensors = [name for name in table if name.startswith(("torque", "tension"))]
    return table[[*places, *sensors]].to_numpy(float)


READERS = {
    "robot's CSV": ("robot", write_robot_csv, said_of_robot),
    "robot's bag": ("robot", write_robot_bag, said_of_robot),
    "arm's CSV": ("arm", write_arm_csv, said_of_arm),
    "arm's bag": ("arm", write_arm_bag, said_of_arm),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", DEFECTS)
def test_a_defect_of_any_size_is_named_or_harmless(tables, robot, kind, reader):
    machine, write, said_of = READERS[reader]
    sound = numbers_of(tables[machine])
    word = "message" if reader == "arm's bag" else "row"

    @EXAMPLES
    @given(seed=SEEDS)
    def named_or_harmless(seed):
        defect = DEFECTS[kind](tables[machine], np.random.default_rng(seed))
        names = [re.sub(r"^row", word, name) for name in defect.names]
        with tempfile.TemporaryDirectory() as place:
            path = write(Path(place) / "run", defect.table)
            try:
                said, said_by_model, numbers = said_of(path, robot)
                harmless = bool((nearest(numbers, sound) < 1e-4).all())
                if not harmless and not any(name in said for name in names):
                    said = f"{said} {said_by_model()}"
            except RecordingError as error:
                said = str(error)
                harmless = False
                assert "\n" not in said
        assert harmless or any(name in said for name in names), (seed, said)

    named_or_harmless()


def changed_bytes(kind, content, rng):
    """The bytes of a file that was damaged."""
    at = int(rng.integers(1, len(content)))
    if kind == "cut":
        return content[:at]
    if kind == "empty":
        return b""
    if kind == "with other bytes at its end":
        return content + rng.bytes(200)
    if kind == "overwritten":
        return content[:at] + rng.bytes(50) + content[at + 50 :]
    if kind == "without its begin":
        return content[at:]
    return rng.bytes(len(content))


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    "kind",
    ["cut", "empty", "with other bytes at its end", "overwritten", "without its begin", "noise"],
)
def test_a_damaged_file_is_named_or_read_as_far_as_it_is_whole(
    tables, robot, kind, reader, tmp_path
):
    machine, write, said_of = READERS[reader]
    sound = numbers_of(tables[machine])

    path = write(tmp_path / "run", tables[machine])
    whole = path.read_bytes()

    @settings(EXAMPLES, max_examples=5)
    @given(seed=SEEDS)
    def named_or_harmless(seed):
        path.write_bytes(changed_bytes(kind, whole, np.random.default_rng(seed)))
        refusal = ""
        numbers = sound
        try:
            _, _, numbers = said_of(path, robot)
        except RecordingError as error:
            refusal = str(error)
        assert path.stem in (refusal or path.stem)
        assert "\n" not in refusal
        wrong = nearest(numbers, sound) > 1e-4
        assert wrong.sum() <= 1  # a number that is cut is a number: of a CSV the last one may be

    named_or_harmless()


def test_the_tables_are_sound(tables, robot, tmp_path):
    for reader, (machine, write, said_of) in READERS.items():
        _, _, numbers = said_of(write(tmp_path / reader.replace(" ", "_"), tables[machine]), robot)
        np.testing.assert_allclose(numbers, numbers_of(tables[machine]), atol=1e-5)
    assert len(ARM_TENSIONS) == LAB.cable_count
