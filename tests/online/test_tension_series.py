"""When an arm in a recording was at rest."""

import numpy as np
from gap_recordings import small_recording

from cablesense_online.commissioning.sensor_statistics import SETTLING_S, series_of, without

NAMES = tuple(f"cable_{n}" for n in range(1, 13))


def test_rest_is_the_usual_pose_without_a_load_once_settled():
    recording = small_recording()
    found = series_of(recording, NAMES)
    assert found.at_rest[:20].all()
    assert not found.at_rest[recording.load_segment > 0].any()
    assert not found.at_rest[recording.command_rad.any(axis=1)].any()
    unloading = np.flatnonzero(np.diff((recording.load_segment > 0).astype(int)) == -1)[0] + 1
    settled = recording.time_s > recording.time_s[unloading] + SETTLING_S
    assert not found.at_rest[unloading]
    assert found.at_rest[settled].any()


def test_a_pull_is_no_rest_nor_is_what_follows_at_once():
    found = series_of(small_recording(), NAMES)
    rest = without(found, 1.0, 2.0)
    assert rest[found.time_s < 1.0].all()
    assert not rest[(found.time_s >= 1.0) & (found.time_s <= 2.0 + SETTLING_S)].any()
