"""The programs of the nodes: each begins with one line where a package that it needs is missing.

A robot's computer has the packages of some nodes only (the extra `robot`).
"""

from __future__ import annotations

import sys
from functools import partial
from importlib import import_module

from cablesense_base.installation import missing_package_line


def _run(node: str) -> int:
    """Run the node of a module `cablesense_ros.<node>_node`; the process's exit code.

    What a kind of machine needs is imported when the node opens its file.
    """
    try:
        module = import_module(f"cablesense_ros.{node}_node")
        code: int = module.main()
    except ModuleNotFoundError as error:
        print(f"cannot start: {missing_package_line(error)}", file=sys.stderr)
        return 2
    return code


sim = partial(_run, "sim")
estimator = partial(_run, "estimator")
page = partial(_run, "page")
can_driver = partial(_run, "can_driver")
can_emulator = partial(_run, "can_emulator")
breather = partial(_run, "breather")
commissioner = partial(_run, "commissioner")
