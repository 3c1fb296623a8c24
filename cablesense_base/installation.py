"""What is installed: files of `config/`, by path or by the name of one; packages; the version.

A wheel or a `colcon build` copies `config/` and the examples that a verb runs to
`share/cablesense_ros` under the prefix that the package was installed to. A checkout, and an
editable installation of one, has them next to the packages.
"""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from cablesense_base import CableSenseError


def config_path(name: str) -> Path:
    """The file or folder `name` of `config/`, for example ``config_path("arms/cdsm.yaml")``.

    `name` is relative to `config/`, with forward slashes; the path is absolute and exists.

    Raises:
        CableSenseError: `name` leads out of `config/`, or the installation does not have it.
    """
    relative = PurePosixPath(name)
    if not name or relative.is_absolute() or ".." in relative.parts:
        raise CableSenseError(
            f"bundled file {name!r}: give a path inside config/, such as 'arms/cdsm.yaml'"
        )
    return _installed(PurePosixPath("config", name))


def _installed(name: PurePosixPath) -> Path:
    packages = Path(__file__).resolve().parents[1]
    roots = [packages] if (packages / "package.xml").is_file() else []
    # packages lie in PREFIX/lib/pythonX.Y/site-packages; Debian puts local/ before lib/
    roots += [prefix / "share" / "cablesense_ros" for prefix in packages.parents[2:4]]
    for root in roots:
        if (root / name).exists():
            return root / name
    sought = ", ".join(map(str, roots))
    raise CableSenseError(f"{name} is not installed; it was sought in {sought}")


@dataclass(frozen=True)
class BundledFiles:
    """One kind of bundled file, each found by its name, and any other of the kind by its path."""

    kind: str  # what a file is, for errors: `arm`
    folder: str  # of `config/`
    suffixes: tuple[str, ...]  # of a path; the first is that of the bundled files
    refusal: type[CableSenseError]  # the error to raise

    def names(self) -> list[str]:
        """Names of the bundled files without suffix; with `/` where they lie in a folder."""
        folder = config_path(self.folder)
        paths = (path.relative_to(folder) for path in folder.rglob(f"*{self.suffixes[0]}"))
        return sorted(path.with_suffix("").as_posix() for path in paths)

    def find(self, name_or_path: str | Path) -> Path:
        """The file of a name (`cdsm`) or a path (`my/arm.yaml`).

        Raises:
            CableSenseError: of the class `refusal`: neither a bundled name nor a file; the message
                lists the bundled names.
        """
        name = str(name_or_path)
        names = self.names()
        suffix = self.suffixes[0]
        bundled = ", ".join(names)
        if name in names:
            return config_path(f"{self.folder}/{name}{suffix}")
        if Path(name).suffix not in self.suffixes:
            raise self.refusal(
                f"unknown {self.kind} {name[:80]!r}; bundled {self.kind}s are {bundled}, "
                f"and any other is given as the path of its {suffix} file"
            )
        if not os.path.isfile(name):  # noqa: PTH113  (False, too, for what cannot be a name)
            raise self.refusal(
                f"no {self.kind} file {name}; give an existing {suffix} file or one of {bundled}"
            )
        return Path(name)


EXTRAS = {
    "cantools": "robot",
    "can": "robot",
    "mujoco": "sim",
    "numba": "sim",
    "scipy": "gap",
    "msgspec": "page",
    "trimesh": "page",
    "viser": "page",
    "websockets": "page",
    "jinja2": "gap",
    "lz4": "gap",
    "matplotlib": "gap",
    "mcap": "gap",
    "pandas": "gap",
    "rosbags": "gap",
    "zstandard": "gap",
    "distributed": "train",
    "onnxscript": "train",
    "PIL": "gap",
    "pyarrow": "train",
    "sklearn": "train",
    "torch": "train",
    "rclpy": "demo",
}
"""The extra of `cablesense_ros` that brings a package, by the name that is imported."""


def missing_package_line(error: ModuleNotFoundError) -> str:
    """What to install, as one line, where an import has failed."""
    package = (error.name or "").partition(".")[0]
    extra = EXTRAS.get(package)
    remedy = f"pip install 'cablesense_ros[{extra}]'" if extra else f"pip install {package}"
    return (
        f"this needs the Python package {package}, which is not installed: {remedy}, "
        "or `make setup` in a checkout"
    )


def package_version() -> str:
    """Installed version of this package; `uninstalled` when run from a bare checkout."""
    try:
        return importlib.metadata.version("cablesense_ros")
    except importlib.metadata.PackageNotFoundError:
        return "uninstalled"
