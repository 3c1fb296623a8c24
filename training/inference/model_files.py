"""The models that come with CableSense, found by name; any other is found by its path."""

from __future__ import annotations

from pathlib import Path

from cablesense_sim.config_files import config_path
from cablesense_training.inference.metadata import ModelFileError


def bundled_models() -> list[str]:
    """Names of the bundled models, for example `cdsm`."""
    return sorted(path.stem for path in config_path("models").glob("*.onnx"))


def find_model(name_or_path: str | Path) -> Path:
    """The model file that a name (`cdsm`) or a path (`my.onnx`) stands for.

    Raises:
        ModelFileError: neither a bundled model nor a file; the message lists the bundled names.
    """
    path = Path(name_or_path)
    if path.suffix == ".onnx":
        if path.is_file():
            return path
        raise ModelFileError(
            f"no model file {path}; give an existing .onnx file or one of {', '.join(bundled_models())}"
        )
    if str(name_or_path) in bundled_models():
        return config_path(f"models/{name_or_path}.onnx")
    raise ModelFileError(
        f"unknown model {str(name_or_path)!r}; bundled models are {', '.join(bundled_models())}, "
        "and any other is given as the path of its .onnx file"
    )
