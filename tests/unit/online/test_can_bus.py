"""Opening an interface, its error state, CANopen node control, and the count of faults."""

import can
import pytest

from cablesense_online.can.bus import (
    BUS_OFF,
    ERROR_ACTIVE,
    BusState,
    CanInterface,
    CanInterfaceError,
    FaultKind,
    FaultLedger,
    booted_node,
)


@pytest.mark.parametrize(
    ("interface", "channel", "refusal"),
    [("cannone", "can0", "one of socketcan, slcan"), ("socketcan", "", "needs a channel")],
)
def test_what_can_never_be_opened_is_refused_at_once(interface, channel, refusal):
    with pytest.raises(CanInterfaceError, match=refusal):
        CanInterface(interface, channel)


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("slcan", "/dev/none_of_that_name"), ("socketcan", "none0"), ("pcan", "PCAN_USBBUS1")],
)
def test_an_interface_that_is_not_there_is_named(interface, channel):
    with pytest.raises(CanInterfaceError, match=f"{interface} {channel} cannot be opened"):
        CanInterface(interface, channel).open()


@pytest.fixture
def ledger():
    return FaultLedger()


@pytest.fixture
def watch(ledger):
    return BusState(CanInterface("socketcan", "can0"), ledger)


def test_bus_off_counts_once_and_a_restart_ends_it(watch, ledger):
    watch.error_frame(0x40, bytes(8))
    watch.error_frame(0x40, bytes(8))
    assert watch.condition == BUS_OFF
    watch.error_frame(0x100, bytes(8))
    assert watch.condition == ERROR_ACTIVE
    assert watch.recoveries == 1
    once = {"socketcan can0": 1}
    assert ledger.report().recent == {FaultKind.BUS_OFF: once, FaultKind.ERROR_FRAME: once}


def test_codes_of_other_drivers_are_not_read_as_classes(ledger):
    watch = BusState(CanInterface("pcan", "PCAN_USBBUS1"), ledger)
    watch.error_frame(0x44, bytes([0, 0x30]))
    assert watch.condition == ERROR_ACTIVE
    assert ledger.report().recent == {FaultKind.ERROR_FRAME: {"pcan PCAN_USBBUS1": 1}}


@pytest.mark.parametrize(
    ("number", "data", "node"),
    [
        (0x703, [0], 3),
        (0x703, [5], None),
        (0x703, [], None),
        (0x704, [0], None),
        (0x003, [0], None),
    ],
)
def test_a_boot_up_message_of_a_node_of_ours(number, data, node):
    frame = can.Message(arbitration_id=number, is_extended_id=False, data=data)
    assert booted_node(frame, [3, 12]) == node
