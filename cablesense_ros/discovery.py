"""How soon nodes find each other, and again after one was killed: settings of Fast DDS."""

from __future__ import annotations

import os
from collections.abc import Mapping, MutableMapping
from typing import Final

from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim.config_files import config_path

PROFILES: Final = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS looks for profiles, by its older and its newer name."""

TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
"""Which transports Fast DDS brings along, where neither a profile nor ROS 2 says otherwise.

Shared memory is left out: a process that is killed leaves its ports in it, and others that wrote
to them need seconds before they reach who comes back. Over UDP they need none.
"""

RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_OLDER_RANGE: Final = "ROS_LOCALHOST_ONLY"
_MIDDLEWARE: Final = "RMW_IMPLEMENTATION"
_DISTRIBUTION: Final = "ROS_DISTRO"


def prefer_quick_discovery(environment: MutableMapping[str, str] = os.environ) -> None:
    """Use a bundled profile and UDP, unless the user has a profile; call it before `rclpy.init`.

    Who asked for this machine alone gets `dds/loopback.xml`, which keeps that promise, in place of
    a discovery range of LOCALHOST, for which ROS 2 adds shared memory whatever else is asked for.
    Other middleware, or another release of ROS 2, finds its settings untouched. Without the
    bundled files everything works as well, with Fast DDS's own timing.
    """
    if any(environment.get(name) for name in PROFILES) or not _speaks_fast_dds(environment):
        return
    alone = _on_this_machine_alone(environment) and not environment.get(TRANSPORTS)
    try:
        path = config_path("dds/loopback.xml" if alone else "dds/quick_discovery.xml")
    except CableSenseError:
        return
    for name in PROFILES:
        environment[name] = str(path)
    if alone:
        environment[RANGE] = "SYSTEM_DEFAULT"
        environment.pop(_OLDER_RANGE, None)
    else:
        environment.setdefault(TRANSPORTS, "UDPv4")


def _on_this_machine_alone(environment: Mapping[str, str]) -> bool:
    # the older variable wins where both are set, as in ROS 2
    if older := environment.get(_OLDER_RANGE):
        return older == "1"
    return environment.get(RANGE) == "LOCALHOST"


def _speaks_fast_dds(environment: Mapping[str, str]) -> bool:
    middleware = environment.get(_MIDDLEWARE) or _default_middleware()
    release = environment.get(_DISTRIBUTION) or "jazzy"
    return middleware.startswith("rmw_fastrtps") and release == "jazzy"


def _default_middleware() -> str:
    from rclpy.utilities import get_rmw_implementation_identifier

    return str(get_rmw_implementation_identifier())
