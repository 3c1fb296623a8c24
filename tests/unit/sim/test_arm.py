"""Arm files: what they may hold, how others are refused, and how they are found by name."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from cablesense_sim.arm import ArmFileError, bundled_arms, find_arm, load_arm, open_arm, parse_arm
from tests.helpers.arm_variants import changed, described, variant, without

NUMBERS = [
    "segments.length_m",
    "segments.mass_kg",
    "segments.plate_offset_m",
    "segments.contact_m",
    "cables.routing_radius_m",
    "cables.angle_deg.first",
    "cables.angle_deg.per_segment",
    "cables.angle_deg.per_cable",
    "cables.stiffness_n_m",
    "cables.pretension_n",
    "cables.run_m",
    "actuators.kp_n_m",
    "sensors.rate_hz",
    "sensors.noise_std_n",
    "sensors.step_n",
]
COUNTS = ["segments.count", "cables.per_segment"]
WORDS = ["segments.joint_axes", "cables.unilateral", "actuators.kind", "sensors.place", "name"]
ALL = [*NUMBERS, *WORDS, *COUNTS, "gravity_m_s2"]
OPTIONAL = {"segments.joint_axes", "cables.unilateral", "cables.angle_deg.first"}


def refusal(description: dict[str, Any]) -> str:
    """The one line that a description is refused with."""
    with pytest.raises(ArmFileError) as caught:
        parse_arm(yaml.safe_dump(description), source="my_arm.yaml")
    line = str(caught.value)
    assert line.startswith("my_arm.yaml: ")
    assert "\n" not in line
    assert len(line) < 500
    return line


@pytest.mark.parametrize("key", ALL)
def test_a_missing_key_is_named(key: str) -> None:
    description = without(described(), key)
    if key in OPTIONAL:
        parse_arm(yaml.safe_dump(description))
    elif key == "cables.stiffness_n_m":
        assert "axial_rigidity_n" in refusal(description)
    else:
        assert f"{key} is missing" in refusal(description)


@pytest.mark.parametrize(
    ("key", "listed"),
    [
        ("segmets", "segments"),
        ("segments.lenght_m", "length_m"),
        ("cables.angle_deg.frist", "first"),
        ("cables.float", "per_segment"),
    ],
)
def test_an_unknown_key_is_answered_with_the_known_ones(key: str, listed: str) -> None:
    line = refusal(changed(described(), key, 1.0))
    assert key.rpartition(".")[2] in line
    assert listed in line.partition("valid keys here")[2]


@pytest.mark.parametrize("key", [*NUMBERS, *COUNTS])
@pytest.mark.parametrize("value", ["thick", True, float("nan"), []])
def test_a_number_must_be_one(key: str, value: Any) -> None:
    line = refusal(changed(described(), key, value))
    assert key.rpartition(".")[2] in line


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("segments.length_m", 130.0),
        ("segments.mass_kg", 500.0),
        ("cables.routing_radius_m", 50.0),
        ("cables.stiffness_n_m", 1e13),
        ("actuators.kp_n_m", 100e-3),
        ("gravity_m_s2", [0.0, 0.0, -9810.0]),
        ("sensors.rate_hz", 1e6),
        ("sensors.step_n", -0.1),
    ],
)
def test_a_wrong_unit_is_caught(key: str, value: Any) -> None:
    line = refusal(changed(described(), key, value))
    assert key in line
    assert repr(value if not isinstance(value, list) else value[-1]) in line


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"segments.plate_offset_m": 0.07}, "guide plates"),
        ({"segments.contact_m": 0.131}, "beyond the end"),
        ({"segments.length_m": [0.13, 0.13, 0.06, 0.13]}, "segment 3"),
        ({"touch.reach_m": [0.05, 0.1301]}, "shortest segment's 0.13 m"),
        ({"touch.reach_m": [-0.001, 0.1]}, "shortest segment's 0.13 m"),
        ({"touch.reach_m": [0.1, 0.05]}, "[nearest, farthest]"),
        ({"touch.reach_m": [0.05, 0.05]}, "[nearest, farthest]"),
        ({"touch.reach_m": 0.1}, "must be a list"),
        ({"cables.angle_deg.per_cable": -90}, "180 degrees"),
        ({"cables.angle_deg.per_cable": 360}, "360 degrees"),
        ({"actuators.kp_n_m": 1.0e7}, "in series"),
        ({"actuators.kp_n_m": 5.0e6}, "5e+06 must exceed"),
        ({"cables.axial_rigidity_n": 1e6}, "exactly one"),
        ({"segments.mass_kg": [0.5, 0.5]}, "lists 2 values"),
        ({"cables.routing_radius_m": [0.05] * 5}, "give one number or 4"),
        ({"segments.length_m": [0.13, 0.13, "x", 0.13]}, "segments.length_m.2 = 'x'"),
        ({"segments.count": 0}, "at least 1"),
        ({"segments.count": 4.5}, "whole number"),
        ({"cables.per_segment": 2}, "= 2: must be at least 3"),
        ({"cables.per_segment": -1}, "fewer cables by a machine file"),
        ({"cables.per_segment": 17}, "at most 16"),
        ({"cables.per_segment": [3, 3, 3, 0]}, "a machine file"),
        ({"cables.pretension_n": 0}, "greater than 0"),
        ({"cables.unilateral": False}, "True"),
        ({"segments.joint_axes": ["z", "y"]}, "must be 'y'"),
        ({"segments": 3}, "must be a mapping with the keys count"),
        ({"gravity_m_s2": [0.0, 0.0]}, "too short"),
        ({"sensors.range_n": [100.0, 0.0]}, "[lowest, highest]"),
        ({"sensors.place": "anchor"}, "'actuator end'"),
        ({"effects": [{"friction": 0.1}]}, "keys here: effect, at, parameters"),
        ({"effects": [{"effect": "frictoin"}]}, "known: actuator_backlash"),
        ({"name": "my arm"}, "letters, digits"),
        ({"name": "a\nb"}, "letters, digits"),
    ],
)
def test_what_cannot_be_is_refused_with_what_could(changes: dict[str, Any], words: str) -> None:
    description = described()
    for key, value in changes.items():
        description = changed(description, key, value)
    line = refusal(description)
    assert words in line
    assert next(iter(changes)).rpartition(".")[2] in line


@pytest.mark.parametrize(
    ("key", "value", "pair"),
    [
        ("cables.per_segment", 4, "cable_1 and cable_4"),
        ("cables.angle_deg.per_segment", 240, "cable_1 and cable_6"),
        ("segments.count", 5, "cable_1 and cable_14"),
    ],
)
def test_two_cables_in_one_hole_are_refused(key: str, value: int, pair: str) -> None:
    """Cables of every segment pass the plates of the first joint."""
    line = refusal(changed(described(), key, value))
    assert f"{pair} into one hole" in line
    assert "with per_cable = " in line


def test_segments_and_cables_are_data_and_every_number_counts_in_the_identity() -> None:
    arm = variant(
        {
            "segments.count": 3,
            "cables.per_segment": 4,
            "cables.angle_deg.per_cable": -90,
            "cables.angle_deg.per_segment": 30,
            "actuators.kp_n_m": math.inf,
        }
    )
    assert (arm.segment_count, arm.cable_count, arm.joint_count) == (3, 12, 6)
    assert arm.cable_names == tuple(f"cable_{i}" for i in range(1, 13))
    assert arm.joint_names[0] == "joint_1_pitch"
    assert arm.joint_names[-1] == "joint_3_yaw"
    identities = {parse_arm(yaml.safe_dump(described())).identity}
    for key in NUMBERS:
        value: Any = described()
        for part in key.split("."):
            value = value[part]
        nudged = float(value) * (1 + 1e-12) if float(value) else 1e-12
        identities.add(variant({key: nudged}).identity)
    assert len(identities) == 1 + len(NUMBERS)


@pytest.mark.parametrize("name", bundled_arms())
def test_every_bundled_arm_loads_and_bears_its_name(name: str) -> None:
    arm = open_arm(name)
    assert arm.name == name
    assert find_arm(name).stem == name
    assert load_arm(find_arm(name)) == arm


@pytest.mark.parametrize(
    "wrong", ["cdsn", "", "CDSM", "../arms/cdsm", "cdsm.yaml", "a\0b", "x" * 5000 + ".yaml"]
)
def test_what_is_neither_is_answered_with_the_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArmFileError) as caught:
        find_arm(wrong)
    assert "cdsm, cdsm_friction, cdsm_lab, cdsm_table2" in str(caught.value)
