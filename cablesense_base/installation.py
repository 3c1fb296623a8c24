"""Where the files of `config/` lie: in a checkout, a colcon workspace or a pip installation.

A wheel or a `colcon build` copies `config/` to `share/cablesense_ros/config` under the prefix that
the package was installed to; a checkout (and an editable installation of one) has it beside the
packages.

Which version of this package made a dataset.
"""

import importlib.metadata
import os
import sys
from pathlib import Path, PurePosixPath

from cablesense_base.errors import CableSenseError

_SHARE = Path("share", "cablesense_ros", "config")


def config_path(name: str) -> Path:
    """Give the file or folder `name` of `config/`, for example ``config_path("arms/cdsm.yaml")``.

    Args:
        name: path relative to `config/`, with forward slashes.

    Returns:
        The absolute path of a file or folder that exists.

    Raises:
        CableSenseError: `name` leads out of `config/`, or no installation has it; the message
            lists where it was sought.
    """
    relative = PurePosixPath(name)
    if not name or relative.is_absolute() or ".." in relative.parts:
        raise CableSenseError(
            f"bundled file {name!r}: give a path inside config/, such as 'arms/cdsm.yaml'"
        )
    roots = _config_roots()
    for root in roots:
        candidate = root / relative
        if candidate.exists():
            return candidate
    sought = ", ".join(str(root) for root in roots)
    raise CableSenseError(f"no bundled file {name!r}; sought in {sought}")


def _config_roots() -> list[Path]:
    """List the folders that may be `config/`; the nearest comes first, so that an overlay wins."""
    module = Path(__file__).resolve()
    checkout = module.parents[1]
    roots = []
    if (checkout / "package.xml").is_file():  # else any site-packages/config would pass for ours
        roots.append(checkout / "config")
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
