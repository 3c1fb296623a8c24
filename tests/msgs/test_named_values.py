"""Values find their place by name, or the message is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.joint_states import NamedOrder
from cablesense_msgs_py.topics import ContractError

NAMES = tuple(f"cable_{i + 1}" for i in range(12))


@given(st.permutations(range(12)))
def test_any_order_gives_the_arms_order(order):
    arranged = NamedOrder(NAMES, "cables").arrange([NAMES[i] for i in order], order, "effort")
    np.testing.assert_array_equal(arranged, np.arange(12.0))


def test_a_good_message_is_taken_after_a_refused_one():
    order = NamedOrder(NAMES, "cables")
    with pytest.raises(ContractError):
        order.pick(["x"], [1.0], "effort")
    assert order.pick(NAMES, range(12), "effort") == tuple(range(12))


@pytest.mark.parametrize(
    ("names", "complaint"),
    [
        (NAMES[:-1], "missing 'cable_12'"),
        ((*NAMES, "cable_13"), "unknown 'cable_13'"),
        ((*NAMES[:-1], "cable_1"), "missing 'cable_12'; more than once 'cable_1'"),
        ((), "and 6 more"),
    ],
)
def test_wrong_names_are_listed(names, complaint):
    with pytest.raises(ContractError, match=complaint):
        NamedOrder(NAMES, "cables").pick(names, [0.0] * len(names), "effort")


@pytest.mark.parametrize("count", [0, 11, 13])
def test_one_value_per_name(count):
    with pytest.raises(ContractError, match=f"effort holds {count} values for 12 names"):
        NamedOrder(NAMES, "cables").pick(NAMES, [0.0] * count, "effort")
