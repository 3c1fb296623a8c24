"""All readers of what comes from outside, and how much of it each is given."""

from __future__ import annotations

from fuzz.files import (
    make_arms,
    make_calibrations,
    make_csv,
    make_dbc,
    make_maps,
    make_mcap,
    make_models,
    make_parquet,
    make_states,
)
from fuzz.frame_sequences import make_frames
from fuzz.messages import make_commands, make_messages
from fuzz.watched import Target

TARGETS = (
    Target("frames", "CAN frames", make_frames, items=4_000, quick_items=12),
    Target("messages", "messages", make_messages, items=1_050, quick_items=3),
    Target("commands", "messages", make_commands, items=400, quick_items=3),
    Target("arms", "files", make_arms, items=3_000, quick_items=12),
    Target("models", "files", make_models, items=3_000, quick_items=12, limit_s=20.0),
    Target("csv", "files", make_csv, items=1_500, quick_items=8),
    Target("mcap", "files", make_mcap, items=2_000, quick_items=8),
    Target("parquet", "files", make_parquet, items=1_500, quick_items=8),
    Target("dbc", "files", make_dbc, items=2_000, quick_items=8),
    Target("maps", "files", make_maps, items=1_000, quick_items=8),
    Target("calibrations", "files", make_calibrations, items=1_000, quick_items=8),
    Target("states", "files", make_states, items=1_000, quick_items=8),
)
