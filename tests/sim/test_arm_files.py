"""An arm is found by its name or by its path, and what is neither is answered with the names."""

from pathlib import Path

import pytest

from cablesense_sim.arm import ArmFileError, bundled_arms, find_arm, load_arm, open_arm


def test_the_arms_of_the_paper_come_along() -> None:
    assert {"cdsm", "cdsm_lab", "cdsm_table2"} <= set(bundled_arms())


@pytest.mark.parametrize("name", bundled_arms())
def test_every_bundled_arm_loads_and_bears_its_name(name: str) -> None:
    arm = open_arm(name)
    assert arm.name == name
    assert find_arm(name).stem == name
    assert load_arm(find_arm(name)) == arm


def test_the_bundled_arms_differ() -> None:
    assert len({open_arm(name).identity for name in bundled_arms()}) == len(bundled_arms())


@pytest.mark.parametrize("suffix", [".yaml", ".yml"])
def test_a_path_stands_for_itself(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mine{suffix}"
    path.write_bytes(find_arm("cdsm").read_bytes())
    assert find_arm(path) == path
    assert find_arm(str(path)) == path
    assert open_arm(path).identity == open_arm("cdsm").identity


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


def test_a_folder_is_no_arm_file(tmp_path: Path) -> None:
    folder = tmp_path / "arms.yaml"
    folder.mkdir()
    with pytest.raises(ArmFileError, match="no arm file"):
        find_arm(folder)
