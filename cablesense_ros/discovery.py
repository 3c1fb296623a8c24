"""How soon nodes find each other, and again after one was killed: settings of Fast DDS."""

from __future__ import annotations

import os
from collections.abc import MutableMapping
from typing import Final

from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim.config_files import config_path

PROFILES: Final = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS looks for profiles, by its older and its newer name."""

TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
"""Which transports Fast DDS brings along, where no profile says otherwise.

Shared memory is left out: a process that is killed leaves its ports in it, and others that wrote
to them need a second or two before they reach who comes back. Over UDP they need none.
"""


def prefer_quick_discovery(environment: MutableMapping[str, str] = os.environ) -> None:
    """Use the bundled profile and UDP, unless the user has a profile; call it before `rclpy.init`.

    Other middleware takes no notice. Without the bundled file everything works as well, with
    Fast DDS's own timing.
    """
    if any(environment.get(name) for name in PROFILES):
        return
    try:
        path = config_path("dds/quick_discovery.xml")
    except CableSenseError:
        return
    for name in PROFILES:
        environment[name] = str(path)
    environment.setdefault(TRANSPORTS, "UDPv4")
