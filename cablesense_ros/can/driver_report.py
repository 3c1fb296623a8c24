"""What the driver says of itself on `/diagnostics`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_ros.can.bus_condition import BusCondition
from cablesense_ros.can.fault import WITHHOLDS, FaultKind
from cablesense_ros.can.fault_ledger import FaultReport

_SHOWN_PLACES = 4


@dataclass(frozen=True)
class SampleCounts:
    """Frames taken, samples given and samples withheld."""

    frames: int = 0
    samples: int = 0
    withheld: int = 0

    def __sub__(self, earlier: SampleCounts) -> SampleCounts:
        return SampleCounts(
            self.frames - earlier.frames,
            self.samples - earlier.samples,
            self.withheld - earlier.withheld,
        )


@dataclass(frozen=True)
class InterfaceState:
    """The interface at present: whether it is open, how often it was, and how the bus stands."""

    name: str
    connected: bool
    openings: int
    last_problem: str
    condition: BusCondition
    recoveries: int


def driver_statuses(
    interface: InterfaceState,
    recent: SampleCounts,
    total: SampleCounts,
    period_s: float,
    silence_s: float,
    stale: bool,
    skew_s: float,
    faults: FaultReport,
) -> list[Status]:
    """The statuses `interface` and `samples`.

    Args:
        interface: at present.
        recent: counts of the last `period_s`.
        total: counts since the node was configured.
        period_s: length of that time.
        silence_s: time since the last sample.
        stale: whether that is too long.
        skew_s: largest of the samples of the period.
        faults: of the period.
    """
    return [
        _interface_status(interface, recent, total, period_s),
        _sample_status(recent, total, period_s, silence_s, stale, skew_s, faults),
    ]


def _interface_status(
    interface: InterfaceState, recent: SampleCounts, total: SampleCounts, period_s: float
) -> Status:
    level, message = Level.OK, f"receiving on {interface.name}"
    if not interface.connected:
        level, message = Level.ERROR, f"{interface.name} is not open: {interface.last_problem}"
    elif interface.condition is BusCondition.OFF:
        level, message = Level.ERROR, "the controller is off the bus and waits to be restarted"
    elif interface.condition is not BusCondition.ACTIVE:
        level, message = Level.WARN, f"the controller is {interface.condition.value}"
    elif not recent.frames:
        level, message = Level.STALE, f"no frame on {interface.name}"
    values = {
        "interface": interface.name,
        "frames (1/s)": f"{recent.frames / period_s:.0f}",
        "frames in all": str(total.frames),
        "bus": interface.condition.value,
        "recoveries from bus off": str(interface.recoveries),
        "openings": str(interface.openings),
    }
    if interface.last_problem:
        values["last problem"] = interface.last_problem
    return Status("interface", level, message, values)


def _sample_status(
    recent: SampleCounts,
    total: SampleCounts,
    period_s: float,
    silence_s: float,
    stale: bool,
    skew_s: float,
    faults: FaultReport,
) -> Status:
    level, message = Level.OK, "every sample whole"
    words = "; ".join(
        f"{count} {kind.value} ({_listed(faults.places[kind])})"
        for kind, count in faults.recent.items()
    )
    if stale:
        level = Level.STALE
        message = f"no sample for {silence_s:.1f} s" + (f": {words}" if words else "")
    elif recent.withheld or WITHHOLDS & set(faults.recent):
        level, message = Level.ERROR, words
        if recent.withheld:
            message = f"{recent.withheld} samples withheld: {words or 'not whole'}"
    elif faults.recent:
        level, message = Level.WARN, words
    values = {
        "rate (Hz)": f"{recent.samples / period_s:.1f}",
        "samples in all": str(total.samples),
        "withheld": str(recent.withheld),
        "withheld in all": str(total.withheld),
        "largest skew (s)": f"{skew_s:.6f}",
    }
    values |= {f"{kind.value} in all": str(faults.total.get(kind, 0)) for kind in FaultKind}
    values |= {f"last {kind.value}": detail for kind, detail in faults.last.items()}
    return Status("samples", level, message, values)


def _listed(places: Mapping[str, int]) -> str:
    shown = ", ".join(sorted(places)[:_SHOWN_PLACES])
    more = len(places) - _SHOWN_PLACES
    return f"{shown} and {more} more" if more > 0 else shown
