"""Counting faults by kind and place."""

from threading import Thread

from cablesense_online.can.faults import ELSEWHERE, PLACES_KEPT, FaultKind, FaultLedger


def test_a_report_covers_the_time_since_the_last_and_totals_go_on():
    ledger = FaultLedger()
    ledger.note(FaultKind.MISSING_CHANNEL, "cable_5")
    ledger.note(FaultKind.MISSING_CHANNEL, "cable_5")
    ledger.note(FaultKind.MISSING_CHANNEL, "cable_7", "cable_7 did not come")
    first, second = ledger.report(), ledger.report()
    assert first.recent == {FaultKind.MISSING_CHANNEL: 3}
    assert first.places[FaultKind.MISSING_CHANNEL] == {"cable_5": 2, "cable_7": 1}
    assert first.last[FaultKind.MISSING_CHANNEL] == "cable_7 did not come"
    assert second.recent == {}
    assert second.total == {FaultKind.MISSING_CHANNEL: 3}


def test_any_number_of_places_takes_little_memory():
    ledger = FaultLedger()
    for number in range(10_000):
        ledger.note(FaultKind.UNKNOWN_ID, hex(number))
    report = ledger.report()
    assert report.recent[FaultKind.UNKNOWN_ID] == 10_000
    assert len(report.places[FaultKind.UNKNOWN_ID]) == PLACES_KEPT + 1
    assert report.places[FaultKind.UNKNOWN_ID][ELSEWHERE] == 10_000 - PLACES_KEPT


def test_two_threads_lose_no_count():
    ledger = FaultLedger()

    def count():
        for _ in range(2_000):
            ledger.note(FaultKind.ERROR_FRAME, "can0")

    threads = [Thread(target=count) for _ in range(2)]
    for thread in threads:
        thread.start()
    seen = 0
    while any(thread.is_alive() for thread in threads):
        seen += ledger.report().recent.get(FaultKind.ERROR_FRAME, 0)
    seen += ledger.report().recent.get(FaultKind.ERROR_FRAME, 0)
    assert seen == ledger.report().total[FaultKind.ERROR_FRAME] == 4_000
