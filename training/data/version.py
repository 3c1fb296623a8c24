"""Which version of this package made a dataset."""

import importlib.metadata


def package_version() -> str:
    """Installed version of this package; `uninstalled` when run from a bare checkout."""
    try:
        return importlib.metadata.version("cablesense_ros")
    except importlib.metadata.PackageNotFoundError:
        return "uninstalled"
