"""What is installed: the files of `config/`, by path or by the name of one, and the version.

A wheel or a `colcon build` copies `config/` and the examples that a verb runs to
`share/cablesense_ros` under the prefix that the package was installed to; a checkout (and an
editable installation of one) has them beside the packages.
"""

from __future__ import annotations

import importlib.metadata
import os
import sys
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from cablesense_base import CableSenseError
from cablesense_base.files import is_file

_SHARE = Path("share", "cablesense_ros")


def config_path(name: str) -> Path:
    """The file or folder `name` of `config/`, for example ``config_path("arms/cdsm.yaml")``.

    `name` is relative to `config/`, with forward slashes; the path is absolute and exists.

    Raises:
        CableSenseError: `name` leads out of `config/`, or no installation has it; the message
            lists where it was sought.
    """
    relative = PurePosixPath(name)
    if not name or relative.is_absolute() or ".." in relative.parts:
        raise CableSenseError(
            f"bundled file {name!r}: give a path inside config/, such as 'arms/cdsm.yaml'"
        )
    roots = [root / "config" for root in _roots()]
    for root in roots:
        candidate = root / relative
        if candidate.exists():
            return candidate
    sought = ", ".join(str(root) for root in roots)
    raise CableSenseError(f"no bundled file {name!r}; sought in {sought}")


def examples_parent() -> Path:
    """The folder that holds `examples/`; on `sys.path` it makes the examples importable.

    Raises:
        CableSenseError: no installation has it.
    """
    for root in _roots():
        if (root / "examples" / "__init__.py").is_file():
            return root
    sought = ", ".join(str(root / "examples") for root in _roots())
    raise CableSenseError(f"the examples are not installed; sought in {sought}")


@dataclass(frozen=True)
class BundledFiles:
    """One kind of bundled file, each found by its name, and any other of the kind by its path."""

    kind: str
    """What a file is, for errors: `arm`."""
    folder: str
    """Of `config/`."""
    suffixes: tuple[str, ...]
    """Of a path; the first is that of the bundled files."""
    refusal: type[CableSenseError]
    """The error to raise."""

    def names(self) -> list[str]:
        """Names of the bundled files without suffix; with `/` where they lie in a folder."""
        folder = config_path(self.folder)
        paths = (path.relative_to(folder) for path in folder.rglob(f"*{self.suffixes[0]}"))
        return sorted(path.with_suffix("").as_posix() for path in paths)

    def find(self, name_or_path: str | Path) -> Path:
        """The file that a name (`cdsm`) or a path (`my/arm.yaml`) stands for.

        Raises:
            CableSenseError: of the class `refusal`: neither a bundled name nor a file; the message
                lists the bundled names.
        """
        name, names, suffix = str(name_or_path), self.names(), self.suffixes[0]
        if name in names:
            return config_path(f"{self.folder}/{name}{suffix}")
        bundled = ", ".join(names)
        if Path(name).suffix in self.suffixes:
            if is_file(name):
                return Path(name)
            raise self.refusal(
                f"no {self.kind} file {name}; give an existing {suffix} file or one of {bundled}"
            )
        raise self.refusal(
            f"unknown {self.kind} {name[:80]!r}; bundled {self.kind}s are {bundled}, "
            f"and any other is given as the path of its {suffix} file"
        )


def _roots() -> list[Path]:
    """List the folders that may hold `config/`; the nearest comes first: an overlay wins."""
    module = Path(__file__).resolve()
    checkout = module.parents[1]
    roots = []
    if (checkout / "package.xml").is_file():  # else any site-packages/config would pass for ours
        roots.append(checkout)
    # the module lies in PREFIX/lib/pythonX.Y/site-packages; Debian puts local/ before lib/
    prefixes = list(module.parents[4:6])
    ament_prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    prefixes += [Path(prefix) for prefix in ament_prefixes if prefix]
    prefixes.append(Path(sys.prefix))
    roots += [prefix / _SHARE for prefix in prefixes]
    return list(dict.fromkeys(roots))


def package_version() -> str:
    """Installed version of this package; `uninstalled` when run from a bare checkout."""
    try:
        return importlib.metadata.version("cablesense_ros")
    except importlib.metadata.PackageNotFoundError:
        return "uninstalled"
