"""One clock for all rows of a bag, whichever messages carry a stamp."""

import numpy as np
import pytest

from cablesense_recording.recording import one_clock

ARRIVAL_NS = 5_000 + 100 * np.arange(6)


@pytest.mark.parametrize(
    ("stamp_ns", "counts", "said"),
    [
        ([0, 0, 0, 0, 0, 0], "arrival", False),
        ([0, 50, 100, 150, 200, 250], "stamp", False),
        ([7, 50, 100, 150, 200, 250], "stamp", False),
        ([0, 900_050, 900_100, 900_150, 900_200, 900_250], "arrival", True),
        ([50, 100, 0, 150, 200, 250], "arrival", True),
        ([50, 100, 0, 90, 200, 250], "stamp", False),
        ([50, 100, 90, 150, 200, 250], "stamp", False),  # runs back, which is another finding
    ],
)
def test_stamps_count_where_all_messages_have_one(stamp_ns, counts, said):
    clock_ns, note = one_clock(ARRIVAL_NS, np.array(stamp_ns))
    assert clock_ns.tolist() == (stamp_ns if counts == "stamp" else ARRIVAL_NS.tolist())
    assert bool(note) == said
