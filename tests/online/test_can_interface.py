"""CAN interfaces: opened by python-can, refused with the reason."""

import can
import pytest

from cablesense_online.can.bus import CanInterface, CanInterfaceError


def test_a_virtual_interface_opens_and_passes_frames():
    interface = CanInterface("virtual", "test_can_interface")
    with interface.open() as one, interface.open() as other:
        one.send(can.Message(arbitration_id=5, is_extended_id=False, data=[1]))
        assert other.recv(1.0).arbitration_id == 5
    assert interface.name == "virtual test_can_interface"


@pytest.mark.parametrize(
    ("interface", "channel", "said"),
    [("cannone", "can0", "one of socketcan, slcan"), ("socketcan", "", "needs a channel")],
)
def test_what_can_never_be_opened_is_refused_at_once(interface, channel, said):
    with pytest.raises(CanInterfaceError, match=said):
        CanInterface(interface, channel)


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("slcan", "/dev/none_of_that_name"), ("socketcan", "none0"), ("pcan", "PCAN_USBBUS1")],
)
def test_an_interface_that_is_not_there_says_so(interface, channel):
    with pytest.raises(CanInterfaceError, match=f"{interface} {channel} cannot be opened"):
        CanInterface(interface, channel).open()


def test_frames_read_over_slcan_bear_no_bus_time():
    assert CanInterface("socketcan", "can0").stamps_frames
    assert not CanInterface("slcan", "/dev/ttyACM0").stamps_frames


def test_only_some_drivers_class_their_error_frames():
    assert CanInterface("socketcan", "can0").classes_errors
    assert not CanInterface("pcan", "PCAN_USBBUS1").classes_errors
