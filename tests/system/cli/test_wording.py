"""Keys of results are words for people, with the unit's sign; names stay as they are."""

import pytest

from cablesense_ros.cli.wording import worded


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("magnitude_mae_n", "magnitude mean error, N"),
        ("stiffness_n_m", "stiffness, N/m"),
        ("moment_n_m", "moment, N·m"),
        ("rate_hz", "rate, Hz"),
        ("contact_accuracy", "contact accuracy"),
        ("place_mm", "place, mm"),
        ("angle_deg", "angle, °"),
    ],
)
def test_a_key_is_words(key: str, words: str) -> None:
    assert worded(key) == words


@pytest.mark.parametrize(
    "name", ["cable_12", "joint_1_pitch", "my arm.yaml", "Arm", "path/of_a/file"]
)
def test_a_name_stays(name: str) -> None:
    assert worded(name) == name
