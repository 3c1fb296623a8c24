"""Frame names, with and without a prefix."""

import pytest

from cablesense_msgs_py.topics import ContractError, Frames


@pytest.mark.parametrize("prefix", ["", "arm/", "a.b/"])
def test_a_segments_frame_leads_back_to_it(prefix):
    frames = Frames(4, prefix)
    assert frames.base == f"{prefix}base_link"
    assert [frames.segment_number(frames.segment(n)) for n in (1, 2, 3, 4)] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    "frame", ["", "base_link", "segment_0", "segment_5", "segment_01", "segment_1 ", "x" * 500]
)
def test_other_frames_are_refused_with_the_valid_ones(frame):
    with pytest.raises(ContractError, match="segment_1, segment_2, segment_3, segment_4"):
        Frames(4).segment_number(frame)
