"""The estimator's diagnostics of its input and its tare."""

from cablesense_msgs_py.messages import Level
from cablesense_online.samples import InputHealth, ProblemKind, SampleClock, SampleError


def status(health, now_s, missing=0, publishers=1):
    return health.status(now_s, lost=missing, publisher_count=publishers)


def fed(clock=None):
    health = InputHealth(clock or SampleClock(0.2), 0.0)
    for k in range(100):
        health.arrived(0.01 * (k + 1))
    return health


def test_rate_and_age():
    clock = SampleClock(0.2)
    health = fed(clock)
    clock.accept(10**18, 10**18 + 4_000_000)
    report = status(health, 1.0)
    assert report.level is Level.OK
    assert report.values["rate (Hz)"] == "100.0"
    assert report.values["largest age (s)"] == "0.0040"


def test_silence_is_stale_before_and_after_the_first_sample():
    assert status(InputHealth(SampleClock(0.2), 0.0), 1.0).message == "no sample received yet"
    report = status(fed(), 3.0)
    assert report.level is Level.STALE
    assert report.message == "no sample for 2.0 s"


def test_refused_samples_are_an_error_until_the_next_report():
    health = fed()
    health.refused(SampleError(ProblemKind.NOT_FINITE, "effort of cable_3 is nan N"))
    report = status(health, 1.0)
    assert report.level is Level.ERROR
    assert "1 not finite" in report.message
    assert "cable_3" in report.values["last refusal"]
    health.arrived(1.05)
    again = status(health, 1.1)
    assert again.level is Level.OK
    assert again.values["refused in all"] == "1"


def test_losses_and_a_second_publisher_are_warnings():
    assert status(fed(), 1.0, missing=3).message == "3 samples dropped"
    assert status(fed(), 1.0, publishers=2).level is Level.WARN
