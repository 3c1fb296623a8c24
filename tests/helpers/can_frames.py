"""Frames of the bundled amplifiers for tests, encoded by cantools alone."""

from __future__ import annotations

import can

from cablesense_online.can.channel_map import open_channel_map

PACKED, PACKED_DATABASE = open_channel_map("twelve_channel_amplifier")
SINGLE, SINGLE_DATABASE = open_channel_map("cia404_amplifier")


def frame(database, message, values, time_s=0.0, **more):
    """One data frame of a message's values."""
    described = database.get_message_by_name(message)
    data = described.encode(values, strict=False)
    return can.Message(
        arbitration_id=described.frame_id,
        is_extended_id=False,
        data=data,
        timestamp=time_s,
        **more,
    )


def packed_cycle(tensions_n, counter, time_s=0.0, step_s=1e-4):
    """The four frames of one cycle of the packed amplifier."""
    frames = [frame(PACKED_DATABASE, "CYCLE", {"CYCLE_COUNTER": counter % 256}, time_s)]
    for number in range(3):
        first = 4 * number + 1
        values = {f"TENSION_{first + k}": tensions_n[first + k - 1] for k in range(4)}
        at_s = time_s + (number + 1) * step_s
        frames.append(frame(PACKED_DATABASE, f"TENSIONS_{first}_TO_{first + 3}", values, at_s))
    return frames


def single_cycle(tensions_n, time_s=0.0, step_s=1e-4, statuses=(0,) * 12):
    """The twelve frames of one cycle of the CiA 404 amplifiers."""
    return [
        frame(
            SINGLE_DATABASE,
            f"TPDO_{node}",
            {f"VALUE_{node}": tension, f"STATUS_{node}": status},
            time_s + (node - 1) * step_s,
        )
        for node, (tension, status) in enumerate(zip(tensions_n, statuses, strict=True), 1)
    ]
