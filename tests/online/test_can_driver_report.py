"""What diagnostics say of the driver."""

from dataclasses import replace

import pytest

from cablesense_msgs_py.diagnostics import Level
from cablesense_online.can.bus import BusCondition
from cablesense_online.can.driver import (
    InterfaceState,
    SampleCounts,
    interface_status,
    sample_status,
)
from cablesense_online.can.faults import FaultKind, FaultLedger

INTERFACE = InterfaceState("socketcan can0", True, 1, "", BusCondition.ACTIVE, 0)
COUNTS = SampleCounts(frames=4000, samples=1000, withheld=0)


def statuses(interface=INTERFACE, recent=COUNTS, total=COUNTS, stale=False, faults=()):
    ledger = FaultLedger()
    for kind, place in faults:
        ledger.note(kind, place)
    samples = sample_status(recent, total, 1.0, 0.3, stale, 3e-4, ledger.report())
    return interface_status(interface, recent, total, 1.0), samples


def test_all_is_well():
    interface, samples = statuses()
    assert (interface.level, samples.level) == (Level.OK, Level.OK)
    assert interface.values["frames (1/s)"] == "4000"
    assert samples.values["rate (Hz)"] == "1000.0"
    assert samples.values["largest skew (s)"] == "0.000300"


def test_totals_stand_beside_what_is_recent():
    total = SampleCounts(frames=90_000, samples=22_000, withheld=7)
    interface, samples = statuses(total=total)
    assert interface.values["frames in all"] == "90000"
    assert samples.values["samples in all"] == "22000"
    assert samples.values["withheld in all"] == "7"


@pytest.mark.parametrize(
    ("change", "level", "said"),
    [
        ({"connected": False, "last_problem": "device gone"}, Level.ERROR, "device gone"),
        ({"condition": BusCondition.OFF}, Level.ERROR, "off the bus"),
        ({"condition": BusCondition.PASSIVE}, Level.WARN, "error passive"),
    ],
)
def test_an_interface_that_is_not_well_says_how(change, level, said):
    interface, _ = statuses(interface=replace(INTERFACE, **change))
    assert interface.level is level
    assert said in interface.message


def test_a_bus_without_frames_is_stale():
    interface, samples = statuses(recent=SampleCounts(), stale=True)
    assert (interface.level, samples.level) == (Level.STALE, Level.STALE)
    assert "no sample for 0.3 s" in samples.message


@pytest.mark.parametrize("kind", FaultKind)
def test_every_fault_is_told_with_its_place_and_counted(kind):
    _, samples = statuses(faults=[(kind, "cable_5"), (kind, "cable_6")])
    assert samples.level in (Level.WARN, Level.ERROR)
    assert f"2 {kind.value} (cable_5, cable_6)" in samples.message
    assert samples.values[f"{kind.value} in all"] == "2"


def test_withheld_samples_are_an_error_and_strange_frames_a_warning():
    _, withheld = statuses(
        recent=SampleCounts(4000, 990, 10), faults=[(FaultKind.MISSING_CHANNEL, "cable_5")]
    )
    _, strange = statuses(faults=[(FaultKind.UNKNOWN_ID, "0x555")])
    assert (withheld.level, strange.level) == (Level.ERROR, Level.WARN)
    assert "10 samples withheld" in withheld.message
