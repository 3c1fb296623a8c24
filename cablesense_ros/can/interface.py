"""Which CAN interface to open, and how (python-can's names)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import can

from cablesense_msgs_py.errors import CableSenseError
from cablesense_ros.can.slcan_bus import SlcanBus

INTERFACES = ("socketcan", "slcan", "pcan", "kvaser", "virtual", "udp_multicast")
"""Those that are tried or documented here; python-can's others may well work."""


class CanInterfaceError(CableSenseError):
    """A CAN interface that cannot be opened: names it, why, and what to look at."""


@dataclass(frozen=True)
class CanInterface:
    """One interface.

    Attributes:
        interface: python-can's name of the kind of adapter.
        channel: `can0`, `/dev/ttyACM0`, `PCAN_USBBUS1`, …: what that kind calls its channels.
        bitrate_bit_s: of the bus; 0 where the system sets it (SocketCAN) or there is none.
    """

    interface: str
    channel: str
    bitrate_bit_s: int = 0

    def __post_init__(self) -> None:
        """Refuse what can never be opened.

        Raises:
            CanInterfaceError: the kind is unknown to python-can, or the channel is empty.
        """
        if self.interface not in can.VALID_INTERFACES:
            raise CanInterfaceError(
                f"interface {self.interface[:40]!r} is unknown to python-can; it must be one of "
                f"{', '.join(INTERFACES)}"
            )
        if not self.channel:
            raise CanInterfaceError(
                f"interface {self.interface} needs a channel, such as can0 or /dev/ttyACM0"
            )

    @property
    def name(self) -> str:
        """For people and diagnostics."""
        return f"{self.interface} {self.channel}"

    @property
    def stamps_frames(self) -> bool:
        """Whether frames bear the time they were on the bus; over slcan it is when they are read.

        (Lawicel's protocol has a stamp of 16 bits, which python-can does not ask for.)
        """
        return self.interface != "slcan"

    @property
    def classes_errors(self) -> bool:
        """Whether error frames bear SocketCAN's classes in their id.

        Other drivers put codes of their own there, which must not be read as such. `virtual`
        passes on whatever was put in, here by the emulator.
        """
        return self.interface in ("socketcan", "virtual")

    def open(self) -> can.BusABC:
        """Open it.

        Raises:
            CanInterfaceError: it is not there, busy, or its driver is not installed.
        """
        options: dict[str, Any] = {}
        if self.bitrate_bit_s:
            options["bitrate"] = self.bitrate_bit_s
        try:
            if self.interface == "slcan":
                bus = SlcanBus(self.channel, sleep_after_open=0.0, **options)
                bus.flush()  # what came before would be taken for new
                return bus
            return can.Bus(
                channel=self.channel, interface=self.interface, ignore_config=True, **options
            )
        except Exception as error:  # each adapter's driver raises errors of its own
            reason = " ".join(str(error).split())[:300] or type(error).__name__
            raise CanInterfaceError(f"{self.name} cannot be opened ({reason})") from error
