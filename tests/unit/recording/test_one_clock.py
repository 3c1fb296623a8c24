"""One clock for all rows of a bag, whichever messages carry a stamp."""

from pathlib import Path

import numpy as np
import pytest

from cablesense_recording.recording import RecordingError, one_clock

ARRIVAL_NS = 5_000 + 100 * np.arange(6)


@pytest.mark.parametrize(
    ("stamp_ns", "counts", "said"),
    [
        ([0, 0, 0, 0, 0, 0], "arrival", False),
        ([0, 50, 100, 150, 200, 250], "stamp", False),
        ([7, 50, 100, 150, 200, 250], "stamp", False),
        ([0, 900_050, 900_100, 900_150, 900_200, 900_250], "arrival", True),
        ([50, 100, 0, 150, 200, 250], "arrival", True),
        ([50, 100, 90, 150, 200, 250], "stamp", False),  # runs back, which is another finding
    ],
)
def test_stamps_count_where_all_messages_have_one(stamp_ns, counts, said):
    clock = one_clock(Path("a.mcap"), ARRIVAL_NS, np.array(stamp_ns))
    assert clock.time_ns.tolist() == (stamp_ns if counts == "stamp" else ARRIVAL_NS.tolist())
    assert bool(clock.notes) == said


@pytest.mark.parametrize("first", [0, 1_700_000_000 * 10**9])
@pytest.mark.parametrize("missing", [(2,), (0, 1), (2, 3)])
def test_stamps_that_are_missing_and_run_back_say_by_how_much_the_stated_ones_do(first, missing):
    stamp_ns = first + 10**8 * np.arange(1, 9)
    stamp_ns[6] -= 3 * 10**8
    stamp_ns[list(missing)] = 0
    arrival_ns = 5_000 + 10**8 * np.arange(8)
    said = f"a.mcap: {len(missing)} of 8 messages have no stamp, and .* time_s runs back by up to"
    with pytest.raises(RecordingError, match=f"{said} 0.2 s"):
        one_clock(Path("a.mcap"), arrival_ns, stamp_ns)
