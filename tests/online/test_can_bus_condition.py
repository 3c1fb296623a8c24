"""Error frames, bus off and the way back, with SocketCAN's classes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.bus import BusCondition, BusState, error_text
from cablesense_online.can.faults import FaultKind, FaultLedger


@pytest.fixture
def watch():
    watch = BusState("can0", True, FaultLedger())
    watch.ledger = watch._ledger
    return watch


@pytest.mark.parametrize(
    ("bits", "condition"),
    [
        (0x04, BusCondition.WARNING),
        (0x08, BusCondition.WARNING),
        (0x10, BusCondition.PASSIVE),
        (0x24, BusCondition.PASSIVE),
        (0x40, BusCondition.ACTIVE),
    ],
)
def test_the_controllers_state_is_followed(watch, bits, condition):
    watch.error_frame(0x04, bytes([0, bits, 0, 0, 0, 0, 0, 0]))
    assert watch.condition is condition


def test_bus_off_counts_once_and_a_restart_ends_it(watch):
    watch.error_frame(0x40, bytes(8))
    watch.error_frame(0x40, bytes(8))
    assert watch.condition is BusCondition.OFF
    watch.error_frame(0x100, bytes(8))
    assert watch.condition is BusCondition.ACTIVE
    assert watch.recoveries == 1
    assert watch.ledger.report().recent == {FaultKind.BUS_OFF: 1, FaultKind.ERROR_FRAME: 1}


def test_a_data_frame_proves_that_the_controller_is_back(watch):
    watch.error_frame(0x40, bytes(8))
    watch.error_frame(0x04, bytes([0, 0x40]))
    assert watch.condition is BusCondition.OFF
    watch.data_frame()
    watch.data_frame()
    assert watch.condition is BusCondition.ACTIVE
    assert watch.recoveries == 1


def test_codes_of_other_drivers_are_not_read_as_classes():
    ledger = FaultLedger()
    watch = BusState("PCAN_USBBUS1", False, ledger)
    watch.error_frame(0x44, bytes([0, 0x30]))
    assert watch.condition is BusCondition.ACTIVE
    assert ledger.report().recent == {FaultKind.ERROR_FRAME: 1}


def test_reopening_is_no_recovery(watch):
    watch.error_frame(0x40, bytes(8))
    watch.reopened()
    assert watch.condition is BusCondition.ACTIVE
    assert watch.recoveries == 0


def test_an_error_frame_is_put_in_words():
    assert error_text(0x24, bytes([0, 0x01])) == (
        "controller, no acknowledge, receive buffer overflow"
    )
    assert "0x200" in error_text(0x200, b"")


@given(st.lists(st.tuples(st.integers(0, 2**29 - 1), st.binary(max_size=8)), max_size=20))
def test_any_error_frame_is_counted(frames):
    watch = BusState("can0", True, FaultLedger())
    for number, data in frames:
        watch.error_frame(number, data)
    noted = watch._ledger.report().recent
    assert sum(noted.values()) <= len(frames)
    assert (watch.condition is BusCondition.OFF) <= (FaultKind.BUS_OFF in noted)
