"""Where commands begin in a bag, and whether the machine may be on its way to the first."""

import pytest

from cablesense_recording.first_command import FirstCommand


def first_command(readings_ns, commands_ns):
    """Of messages at these times, in their order."""
    first = FirstCommand("joint_commands")
    kinds = [(time, first.reading) for time in readings_ns]
    kinds += [(time, first.command) for time in commands_ns]
    for time, take in sorted(kinds, key=lambda kind: kind[0]):
        take(time)
    return first


@pytest.mark.parametrize(
    ("readings_ns", "commands_ns", "rows_before", "comes_inside"),
    [
        ([10, 20], [5], 0, False),  # before all readings
        ([10, 20, 30], [25], 2, True),  # once, in their midst
        ([10, 20, 30], [25, 45, 65], 2, False),  # the recording cuts into a stream
        ([10, 20, 300], [250, 270, 290], 2, True),  # a stream that begins in the recording
        ([], [25], 0, False),
    ],
)
def test_a_first_command_comes_inside_unless_it_is_of_a_stream(
    readings_ns, commands_ns, rows_before, comes_inside
):
    first = first_command(readings_ns, commands_ns)
    assert first.rows_before == rows_before
    assert first.comes_inside == comes_inside
    assert len(first.notes) == (rows_before > 0)
