"""Which nodes find each other, and how soon: settings of ROS 2 and Fast DDS, without rclpy."""

from __future__ import annotations

import fcntl
import functools
import os
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Final

from cablesense_base import CableSenseError
from cablesense_base.installation import config_path

PROFILES: Final = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS looks for profiles, by its older and its newer name."""

TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
"""Which transports Fast DDS brings along, where neither a profile nor ROS 2 sets others.

Shared memory is left out: a process that is killed leaves its ports in it, and others that wrote
to them need seconds before they reach who comes back. Over UDP they need none.
"""

RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
DOMAIN: Final = "ROS_DOMAIN_ID"
_OLDER_RANGE: Final = "ROS_LOCALHOST_ONLY"
_DOMAINS: Final = range(1, 101)
"""Domain ids that are safe on Linux go from 0 to 101; 0 is everyone's."""


def prefer_quick_discovery(environment: MutableMapping[str, str] = os.environ) -> None:
    """Use a bundled profile and UDP, unless the user has a profile; call it before `rclpy.init`.

    Who asked for this machine alone gets `dds/loopback.xml`, which keeps that promise, in place of
    a discovery range of LOCALHOST, for which ROS 2 adds shared memory whatever else is asked for.
    Other middleware, or another release of ROS 2, finds its settings untouched.
    """
    middleware = environment.get("RMW_IMPLEMENTATION") or "rmw_fastrtps_cpp"
    release = environment.get("ROS_DISTRO") or "jazzy"
    if not middleware.startswith("rmw_fastrtps") or release != "jazzy":
        return
    if any(environment.get(name) for name in PROFILES):
        return
    # the older variable wins where both are set, as in ROS 2
    older = environment.get(_OLDER_RANGE)
    alone = older == "1" if older else environment.get(RANGE) == "LOCALHOST"
    alone = alone and not environment.get(TRANSPORTS)
    path = config_path("dds/loopback.xml" if alone else "dds/quick_discovery.xml")
    for name in PROFILES:
        environment[name] = str(path)
    if alone:
        environment[RANGE] = "SYSTEM_DEFAULT"
        environment.pop(_OLDER_RANGE, None)
    else:
        environment.setdefault(TRANSPORTS, "UDPv4")


def own_graph(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of nodes that stay on this machine, in a separate domain.

    A domain, a discovery range or a profile of Fast DDS that is set already stays.
    """
    own = dict(environment)
    own.setdefault(RANGE, "LOCALHOST")
    prefer_quick_discovery(own)
    if not own.get(DOMAIN):
        own[DOMAIN] = str(free_domain())
    own.setdefault("OMP_NUM_THREADS", "1")
    own["PYTHONUNBUFFERED"] = "1"
    return own


@functools.cache
def free_domain() -> int:
    """A ROS domain that no other process on this machine has got here, for this process's life."""
    start = os.getpid() % len(_DOMAINS)
    for domain in (*_DOMAINS[start:], *_DOMAINS[:start]):
        path = Path(tempfile.gettempdir(), f"cablesense_ros_domain_{domain}.lock")
        try:  # what is opened stays open until the process ends
            fcntl.flock(os.open(path, os.O_WRONLY | os.O_CREAT), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # in use, or another user's
            continue
        return domain
    raise CableSenseError(f"all ROS domains are in use; set {DOMAIN} to one that may be shared")
