"""No false sample with a second sender on the bus: some runs of each kind over a virtual bus."""

import can_intruders
import pytest


@pytest.mark.parametrize("attack", can_intruders.ATTACKS, ids=lambda one: one.__name__)
@pytest.mark.parametrize("name", [can_intruders.PACKED, can_intruders.CIA404])
def test_a_second_sender_makes_no_false_sample(name, attack):
    lines = [can_intruders.run(name, attack, number) for number in range(4)]
    assert sum(line.false_samples() for line in lines) == 0
    assert all(len(line.samples) >= 7 for line in lines)  # those before the attack


@pytest.mark.parametrize("traffic", can_intruders.HEALTHY, ids=lambda one: one.__name__)
@pytest.mark.parametrize("name", [can_intruders.PACKED, can_intruders.CIA404])
def test_healthy_traffic_loses_a_sample_to_a_lost_frame_alone(name, traffic):
    line = can_intruders.run(name, traffic, 0)
    lost = len(line.sent) - len(line.samples)
    assert lost == (traffic is can_intruders.one_lost_frame)
