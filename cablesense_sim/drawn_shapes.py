"""Sizes of an arm's parts as drawn, where an arm file has none; without part in statics."""

PLATE_HALF_THICKNESS_M = 0.0015
"""Of a guide plate."""
PLATE_RADIUS = 1.08
"""Of a guide plate, by that of the outermost holes."""
SEGMENT_RADIUS = 0.12
"""Of a segment, by its length."""
