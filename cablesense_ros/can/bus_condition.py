"""What error frames say of the bus: their classes, and whether the controller is off the bus.

Classes and bits are those of SocketCAN (`linux/can/error.h`), which python-can passes on in the
id and data of a frame with `is_error_frame`. Other interfaces send error frames with codes of
their own, or none: slcan has no such frames, `virtual` and `udp_multicast` no bus that could fail.
"""

from __future__ import annotations

from enum import Enum

from cablesense_ros.can.fault import FaultKind
from cablesense_ros.can.fault_ledger import FaultLedger

BUS_OFF_CLASS = 0x40
RESTARTED_CLASS = 0x100
CONTROLLER_CLASS = 0x04
_CLASSES = {
    0x01: "transmit timeout",
    0x02: "lost arbitration",
    CONTROLLER_CLASS: "controller",
    0x08: "protocol violation",
    0x10: "transceiver",
    0x20: "no acknowledge",
    BUS_OFF_CLASS: "bus off",
    0x80: "bus error",
    RESTARTED_CLASS: "controller restarted",
}
_CONTROLLER_BITS = {
    0x01: "receive buffer overflow",
    0x02: "transmit buffer overflow",
    0x04: "receive warning",
    0x08: "transmit warning",
    0x10: "receive passive",
    0x20: "transmit passive",
    0x40: "active again",
}
_WARNING_BITS, _PASSIVE_BITS, _ACTIVE_BIT = 0x0C, 0x30, 0x40


class BusCondition(Enum):
    """The controller's error state (ISO 11898-1); the value is what diagnostics call it."""

    ACTIVE = "error active"
    WARNING = "error warning"
    PASSIVE = "error passive"
    OFF = "bus off"


class BusWatch:
    """Follows the condition of the bus.

    Attributes:
        condition: the present one.
        recoveries: how often the controller came back from bus off.
    """

    def __init__(self, place: str, classes: bool, ledger: FaultLedger) -> None:
        """`place` names the interface; `classes` says if error frames bear SocketCAN's classes.

        Without them error frames are counted, and the condition stays unknown, that is active.
        """
        self._place = place
        self._classes = classes
        self._ledger = ledger
        self.condition = BusCondition.ACTIVE
        self.recoveries = 0

    def error_frame(self, arbitration_id: int, data: bytes) -> None:
        """Take an error frame in.

        A controller that is off the bus neither sends nor receives until it is restarted: by the
        kernel after `restart-ms`, by an adapter's own rule, or by reopening it.
        """
        if not self._classes:
            self._ledger.note(FaultKind.ERROR_FRAME, self._place, "an error frame without class")
            return
        if arbitration_id & BUS_OFF_CLASS:
            if self.condition is not BusCondition.OFF:
                self._ledger.note(
                    FaultKind.BUS_OFF, self._place, error_words(arbitration_id, data)
                )
            self.condition = BusCondition.OFF
            return
        self._ledger.note(FaultKind.ERROR_FRAME, self._place, error_words(arbitration_id, data))
        if arbitration_id & RESTARTED_CLASS:
            self._recover()
        if arbitration_id & CONTROLLER_CLASS and len(data) > 1:
            self._controller(data[1])

    def data_frame(self) -> None:
        """A data frame came, so the controller is on the bus."""
        if self.condition is BusCondition.OFF:
            self._recover()

    def reopened(self) -> None:
        """The interface was opened anew."""
        self.condition = BusCondition.ACTIVE

    def _recover(self) -> None:
        if self.condition is BusCondition.OFF:
            self.recoveries += 1
        self.condition = BusCondition.ACTIVE

    def _controller(self, bits: int) -> None:
        if self.condition is BusCondition.OFF:
            return
        if bits & _PASSIVE_BITS:
            self.condition = BusCondition.PASSIVE
        elif bits & _WARNING_BITS:
            self.condition = BusCondition.WARNING
        elif bits & _ACTIVE_BIT:
            self.condition = BusCondition.ACTIVE


def error_words(arbitration_id: int, data: bytes) -> str:
    """What an error frame says, in words."""
    words = [word for bit, word in _CLASSES.items() if arbitration_id & bit]
    if arbitration_id & CONTROLLER_CLASS and len(data) > 1:
        words += [word for bit, word in _CONTROLLER_BITS.items() if data[1] & bit]
    return ", ".join(words) or f"error frame of class 0x{arbitration_id:X}"
