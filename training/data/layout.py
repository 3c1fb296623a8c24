"""Datasets as Parquet files: one row a sample, units and provenance in the schema's metadata.

Metadata keys (all text): `cablesense.format` (version of this layout), `cablesense.arm_identity`,
`cablesense.arm` (the arm file's content, YAML), `cablesense.cables` and `cablesense.joints` (JSON
lists, the order of the columns), `cablesense.protocol` (JSON, kind and all options),
`cablesense.seed`, `cablesense.version` (of this package) and `cablesense.command`. Nothing in a
file depends on when, where or by how many workers it was made.
"""

from __future__ import annotations

import json
from typing import NamedTuple

import pyarrow as pa
import yaml

from cablesense_sim.arm import Arm
from cablesense_training.data.protocols import Protocol, SingleContact
from cablesense_training.data.version import package_version

FORMAT = "1"
PREFIX = "cablesense."


class Column(NamedTuple):
    """One column: `array[:, place]` of the dataset, or all of it when `place` is None."""

    name: str
    unit: str
    type: pa.DataType
    array: str
    place: int | None


def columns(arm: Arm, protocol: Protocol) -> list[Column]:
    """The columns of a dataset of that arm and protocol, in the file's order."""
    number, whole = pa.float64(), pa.int64()
    found = [Column("sample_id", "1", whole, "sample_id", None)]
    for i, name in enumerate(arm.joint_names):
        found.append(Column(f"command_{name}_rad", "rad", number, "command_rad", i))
    for label in ("tension_difference", "unloaded"):
        for i, name in enumerate(arm.cable_names):
            found.append(Column(f"{label}_{name}_n", "N", number, f"{label}_n", i))
    if isinstance(protocol, SingleContact):
        found.append(Column("segment", "1", whole, "segment", None))
        found.append(Column("angle_deg", "deg", number, "angle_deg", None))
        found.append(Column("magnitude_n", "N", number, "magnitude_n", None))
    else:
        for i in range(arm.segment_count):
            label = f"segment_{i + 1}"
            found.append(Column(f"contact_{label}", "1", pa.bool_(), "contacts", i))
            found.append(Column(f"angle_{label}_deg", "deg", number, "angles_deg", i))
            found.append(Column(f"magnitude_{label}_n", "N", number, "magnitudes_n", i))
    for name in ("slack_cables", "redrawn"):
        found.append(Column(name, "1", whole, name, None))
    return found


def schema(arm: Arm, protocol: Protocol, seed: int, command: str) -> pa.Schema:
    """Columns with their units, and the metadata of the module's docstring."""
    listed = [
        pa.field(c.name, c.type, nullable=False, metadata={"unit": c.unit})
        for c in columns(arm, protocol)
    ]
    metadata = {
        "format": FORMAT,
        "arm_identity": arm.identity,
        "arm": yaml.safe_dump(arm.model_dump(), sort_keys=False),
        "cables": json.dumps(arm.cable_names),
        "joints": json.dumps(arm.joint_names),
        "protocol": json.dumps(protocol.options(), sort_keys=True),
        "seed": str(seed),
        "version": package_version(),
        "command": command,
    }
    return pa.schema(listed, metadata={PREFIX + key: text for key, text in metadata.items()})
