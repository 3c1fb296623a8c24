"""The models that come with CableSense, found by name; any other is found by its path."""

from __future__ import annotations

from pathlib import Path

from cablesense_sim.config_files import config_path
from cablesense_training.inference.metadata import ModelFileError


def bundled_models() -> list[str]:
    """Names of the bundled models, for example `cdsm`; peers to compare with are in `peers/`."""
    folder = config_path("models")
    return sorted(
        path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.onnx")
    )


def find_model(name_or_path: str | Path) -> Path:
    """The model file that a name (`cdsm`) or a path (`my.onnx`) stands for.

    Raises:
        ModelFileError: neither a bundled model nor a file; the message lists the bundled names.
    """
    name, bundled = str(name_or_path), bundled_models()
    if Path(name).suffix == ".onnx":
        if _is_file(Path(name)):
            return Path(name)
        raise ModelFileError(
            f"no model file {name}; give an existing .onnx file or one of {', '.join(bundled)}"
        )
    if name in bundled:
        return config_path(f"models/{name}.onnx")
    raise ModelFileError(
        f"unknown model {name!r}; bundled models are {', '.join(bundled)}, "
        "and any other is given as the path of its .onnx file"
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long, or with a null in it
        return False
