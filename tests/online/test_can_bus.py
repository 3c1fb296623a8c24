"""Opening an interface, its error state, its clock, and CANopen node control."""

import math

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.bus import (
    BusClock,
    BusCondition,
    BusState,
    CanInterface,
    CanInterfaceError,
    FaultKind,
    FaultLedger,
    booted_node,
    start_frames,
)


def test_a_virtual_interface_opens_and_passes_frames():
    interface = CanInterface("virtual", "test_can_interface")
    with interface.open() as one, interface.open() as other:
        one.send(can.Message(arbitration_id=5, is_extended_id=False, data=[1]))
        assert other.recv(1.0).arbitration_id == 5
    assert interface.name == "virtual test_can_interface"


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


def test_frames_read_over_slcan_bear_no_bus_time():
    assert CanInterface("socketcan", "can0").stamps_frames
    assert not CanInterface("slcan", "/dev/ttyACM0").stamps_frames


def test_only_some_drivers_class_their_error_frames():
    assert CanInterface("socketcan", "can0").classes_errors
    assert not CanInterface("pcan", "PCAN_USBBUS1").classes_errors


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


@pytest.mark.parametrize(
    ("number", "data", "text"),
    [
        (0x24, bytes([0, 0x01]), "controller, no acknowledge, receive buffer overflow"),
        (0x200, b"", "error frame of class 0x200"),
    ],
)
def test_the_meaning_of_an_error_frame_is_kept(watch, number, data, text):
    watch.error_frame(number, data)
    assert watch.ledger.report().last == {FaultKind.ERROR_FRAME: text}


@given(st.lists(st.tuples(st.integers(0, 2**29 - 1), st.binary(max_size=8)), max_size=20))
def test_any_error_frame_is_counted(frames):
    watch = BusState("can0", True, FaultLedger())
    for number, data in frames:
        watch.error_frame(number, data)
    noted = watch._ledger.report().recent
    assert sum(noted.values()) <= len(frames)
    assert (watch.condition is BusCondition.OFF) <= (FaultKind.BUS_OFF in noted)


NOW_S = 1.7e9


def test_stamps_of_this_machines_clock_are_kept():
    clock = BusClock()
    for number in range(100):
        stamp_s = NOW_S + number * 1e-3
        late_s = 0.03 if number % 7 == 0 else 1e-4
        assert clock.time_s(stamp_s, stamp_s + late_s) == stamp_s


def test_an_adapters_own_clock_is_carried_over_and_its_drift_followed():
    rng, clock, error_s = np.random.default_rng(0), BusClock(), []
    for number in range(20_000):
        true_s = number * 1e-2
        stamp_s = 12.0 + true_s * (1.0 + 100e-6)
        arrival_s = NOW_S + true_s + 1e-4 + rng.exponential(1e-3)
        error_s.append(clock.time_s(stamp_s, arrival_s) - (NOW_S + true_s))
    assert np.abs(error_s[100:]).max() < 2e-3
    assert np.std(error_s[100:]) < 0.5e-3  # not the millisecond by which arrival is scattered


@pytest.mark.parametrize("stamp_s", [0.0, -1.0, math.nan, math.inf])
def test_without_a_usable_stamp_a_frame_counts_from_arrival(stamp_s):
    assert BusClock().time_s(stamp_s, NOW_S) == NOW_S


def test_a_clock_that_was_set_is_noticed():
    clock = BusClock()
    clock.time_s(500.0, NOW_S)
    assert clock.time_s(1.0, NOW_S + 1.0) == pytest.approx(NOW_S + 1.0)
    assert clock.time_s(NOW_S + 2.0, NOW_S + 2.0) == pytest.approx(NOW_S + 2.0)


def test_a_restart_forgets_the_clock():
    clock = BusClock()
    clock.time_s(500.0, NOW_S)
    clock.restart()
    assert clock.time_s(499.5, NOW_S + 1.0) == pytest.approx(NOW_S + 1.0)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=50))
def test_any_stamps_give_finite_times(stamps_s):
    clock = BusClock()
    for number, stamp_s in enumerate(stamps_s):
        assert math.isfinite(clock.time_s(stamp_s, NOW_S + number))


def test_each_node_is_started_by_command_and_number_on_id_0():
    frames = start_frames([3, 12])
    assert [frame.arbitration_id for frame in frames] == [0, 0]
    assert [bytes(frame.data) for frame in frames] == [b"\x01\x03", b"\x01\x0c"]
    assert not any(frame.is_extended_id for frame in frames)


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


def test_an_extended_frame_is_no_boot_up():
    assert booted_node(can.Message(arbitration_id=0x703, data=[0]), [3]) is None
