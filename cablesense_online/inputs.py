"""What an estimator takes, and by which recorded topic a replay takes the same.

Whoever lets the estimator subscribe to a topic enters it here: a test compares this table with a
live node, and `replay` takes what stands here, and refuses what it does not know how to take.
"""

from __future__ import annotations

from typing import Final

from cablesense_msgs_py import topics

REPLAYED_FROM: Final = {
    topics.CABLE_TENSIONS: topics.CABLE_TENSIONS,
    topics.JOINT_COMMANDS: topics.JOINT_COMMANDS,
    topics.JOINT_STATES: topics.JOINT_STATES,
    topics.CABLE_OFFSETS: topics.CABLE_OFFSETS,
    topics.CALIBRATION: topics.CALIBRATION_USED,
    topics.JOINT_TRAJECTORY: None,
}
"""By topics that a node subscribes to. A calibration is taken from what the estimator published,
which has the moment from which on it counts. A trajectory becomes commands by the node's clock,
which no recording has: such a run is not repeated."""
