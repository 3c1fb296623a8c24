"""The emulated amplifier: what the driver makes of its frames, with and without each fault."""

import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE, SINGLE, SINGLE_DATABASE

from cablesense_base.installation import config_path
from cablesense_online.can.bus import CanInterface, booted_node, start_frames
from cablesense_online.can.channel_map import parse_database
from cablesense_online.can.emulated_amplifier import (
    EmulatedAmplifier,
    FaultRequestError,
)
from cablesense_online.can.faults import FaultKind, FaultLedger
from cablesense_online.can.tension_reader import TensionReader

NOW_S = 1.7e9
TENSIONS_N = np.linspace(40.0, 62.0, 12)


class Bench:
    """An amplifier and a reader on one clock, without a bus between."""

    def __init__(self, channel_map=PACKED, database=PACKED_DATABASE):
        self.map = channel_map
        self.ledger = FaultLedger()
        self.amplifier = EmulatedAmplifier(channel_map, database)
        self.reader = TensionReader(
            channel_map, database, CanInterface("virtual", "bench"), self.ledger
        )
        self.time_s = NOW_S
        for frame in start_frames(channel_map.nmt_start_nodes):
            self.amplifier.take(frame)

    def cycles(self, count, tensions_n=TENSIONS_N):
        """Samples of so many cycles, a hundredth of the cycle from frame to frame."""
        samples = []
        for _ in range(count):
            begin_s = self.time_s
            for planned in self.amplifier.cycle(tensions_n):
                self.time_s += planned.wait_s + self.map.cycle_time_s / 100.0
                planned.frame.timestamp = self.time_s
                sample = self.reader.take(planned.frame, self.time_s + 1e-5, self.time_s)
                samples += [sample] if sample is not None else []
            self.time_s = max(self.time_s, begin_s + self.map.cycle_time_s)
        return samples

    def request(self, text):
        self.amplifier.request(text)


@pytest.fixture
def packed():
    return Bench()


@pytest.fixture
def single():
    return Bench(SINGLE, SINGLE_DATABASE)


@pytest.fixture(params=["packed", "single"])
def bench(request):
    return request.getfixturevalue(request.param)


def test_without_a_fault_every_cycle_is_a_sample(bench):
    samples = bench.cycles(50)
    assert len(samples) == 50
    assert np.allclose([sample.tensions_n for sample in samples], TENSIONS_N, atol=0.051)
    assert bench.ledger.report().recent == {}


@pytest.mark.parametrize(
    ("text", "kind", "share_given"),
    [
        ("missing_channel cable_6", FaultKind.MISSING_CHANNEL, 0.0),
        ("late_channel cable_6", FaultKind.LATE_CHANNEL, 0.0),
        ("wrong_length cable_6", FaultKind.WRONG_LENGTH, 0.0),
        ("unreadable cable_6", FaultKind.UNREADABLE, 0.0),
        ("over_range cable_6", FaultKind.OVER_RANGE, 0.0),
        ("under_range cable_6", FaultKind.UNDER_RANGE, 0.0),
        ("unknown_id", FaultKind.UNKNOWN_ID, 1.0),
        ("error_frame", FaultKind.ERROR_FRAME, 1.0),
        ("bus_off", FaultKind.BUS_OFF, 0.0),
        ("counter_gap", FaultKind.COUNTER_GAP, 1.0),
    ],
)
def test_each_fault_is_named_and_ends_with_its_cause(packed, text, kind, share_given):
    packed.cycles(20)
    packed.request(text)
    assert len(packed.cycles(100)) == pytest.approx(100 * share_given, abs=1)
    assert kind in packed.ledger.report().recent
    packed.request("")
    packed.cycles(2)  # the fault's last sample is named with the next one
    packed.ledger.report()
    samples = packed.cycles(100)
    assert len(samples) == 100
    assert np.allclose(samples[-1].tensions_n, TENSIONS_N, atol=0.051)
    assert packed.ledger.report().recent == {}


def test_a_stuck_channel_is_found_while_the_others_move(packed):
    packed.request("stuck_value cable_6")
    given = sum(len(packed.cycles(1, TENSIONS_N + 0.05 * number)) for number in range(2500))
    assert 1900 < given < 2100
    assert packed.ledger.report().places == {FaultKind.STUCK_VALUE: {"cable_6": 2500 - given}}


def test_a_flood_is_named_and_costs_no_sample(packed):
    packed.request("flooded")
    assert len(packed.cycles(2000)) == 2000
    assert set(packed.ledger.report().recent) == {FaultKind.FLOODED, FaultKind.UNKNOWN_ID}


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("invalid_status cable_6", FaultKind.INVALID_STATUS),
        ("over_range cable_6", FaultKind.OVER_RANGE),
        ("under_range cable_6", FaultKind.UNDER_RANGE),
        ("missing_channel cable_6", FaultKind.MISSING_CHANNEL),
    ],
)
def test_faults_of_a_node_are_told_by_its_status(single, text, kind):
    single.request(text)
    assert single.cycles(20) == []
    single.reader.silence(single.time_s + 1.0)
    assert set(single.ledger.report().places[kind]) == {"cable_6"}


def test_nan_is_told_from_a_signal_that_can_carry_it(packed):
    with pytest.raises(FaultRequestError, match="whole number"):
        packed.request("not_finite cable_3")
    text = config_path("can/cia404_amplifier.dbc").read_text(encoding="utf-8")
    floating = Bench(SINGLE, parse_database(text + "SIG_VALTYPE_ 387 VALUE_3 : 1;\n"))
    floating.request("not_finite cable_3")
    assert floating.cycles(5) == []
    assert floating.ledger.report().places == {FaultKind.NOT_FINITE: {"cable_3": 5}}


def test_silence_sends_nothing(packed):
    packed.request("silent_bus")
    assert packed.amplifier.cycle(TENSIONS_N) == []


def test_canopen_nodes_send_only_after_they_were_started():
    amplifier = EmulatedAmplifier(SINGLE, SINGLE_DATABASE)
    booted = [booted_node(frame, SINGLE.nmt_start_nodes) for frame in amplifier.power_up()]
    assert booted == list(range(1, 13))
    assert amplifier.cycle(TENSIONS_N) == []
    amplifier.take(start_frames([4])[0])
    assert [one.frame.arbitration_id for one in amplifier.cycle(TENSIONS_N)] == [0x184]
    amplifier.take(start_frames([0])[0])
    assert len(amplifier.cycle(TENSIONS_N)) == 12
    amplifier.power_up()
    assert amplifier.cycle(TENSIONS_N) == []
