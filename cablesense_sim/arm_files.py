"""The arm files that come with CableSense, found by name; any other arm is found by its path."""

from __future__ import annotations

from pathlib import Path

from cablesense_sim.arm import Arm, ArmFileError, load_arm
from cablesense_sim.config_files import config_path

ARM_SUFFIXES = (".yaml", ".yml")


def bundled_arms() -> list[str]:
    """Names of the bundled arms, for example `cdsm`."""
    return sorted(path.stem for path in config_path("arms").glob("*.yaml"))


def find_arm(name_or_path: str | Path) -> Path:
    """The arm file that a name (`cdsm`) or a path (`my/arm.yaml`) stands for.

    Raises:
        ArmFileError: neither a bundled arm nor a file; the message lists the bundled names.
    """
    path = Path(name_or_path)
    if path.suffix in ARM_SUFFIXES:
        if _is_file(path):
            return path
        raise ArmFileError(
            f"no arm file {path}; give an existing .yaml file or one of "
            f"{', '.join(bundled_arms())}"
        )
    if str(name_or_path) in bundled_arms():
        return config_path(f"arms/{name_or_path}.yaml")
    raise ArmFileError(
        f"unknown arm {str(name_or_path)!r}; bundled arms are {', '.join(bundled_arms())}, "
        "and any other is given as the path of its .yaml file"
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name too long to be one
        return False


def open_arm(name_or_path: str | Path) -> Arm:
    """Find and read an arm.

    Raises:
        ArmFileError: as `find_arm` and `load_arm`.
    """
    return load_arm(find_arm(name_or_path))
