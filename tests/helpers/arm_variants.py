"""Arms that differ from the bundled one in a few keys."""

from typing import Any

import yaml

from cablesense_sim.arm import Arm, find_arm, parse_arm

SOFT_CABLES = {
    "name": "soft",
    "segments.count": 2,
    "segments.mass_kg": 0.2,
    "cables.per_segment": 4,
    "cables.angle_deg": {"first": 0, "per_segment": 45, "per_cable": -90},
    "cables.stiffness_n_m": 3.0e3,
}
"""Changes that make two segments with four soft cables each."""


def described(name: str = "cdsm") -> dict[str, Any]:
    """The bundled description as plain values."""
    return yaml.safe_load(find_arm(name).read_text(encoding="utf-8"))


def changed(description: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A description with one value replaced, named like `cables.angle_deg.first`."""
    first, _, rest = key.partition(".")
    value = changed(description.get(first, {}), rest, value) if rest else value
    return {**description, first: value}


def without(description: dict[str, Any], key: str) -> dict[str, Any]:
    """A description that lacks one key."""
    first, _, rest = key.partition(".")
    if rest:
        return {**description, first: without(description[first], rest)}
    return {name: value for name, value in description.items() if name != first}


def variant(changes: dict[str, Any], name: str = "cdsm") -> Arm:
    """A bundled arm with some keys changed; `None` takes a key away."""
    description = described(name)
    for key, value in changes.items():
        description = (
            without(description, key) if value is None else changed(description, key, value)
        )
    return parse_arm(yaml.safe_dump(description))


def five_by_four(name: str = "cdsm") -> Arm:
    """A bundled arm with 5 segments and 4 cables on each, all 20 holes apart."""
    changes = {
        "name": "five_by_four",
        "segments.count": 5,
        "cables.per_segment": 4,
        "cables.angle_deg": {"first": 0, "per_segment": 18, "per_cable": -90},
    }
    return variant(changes, name)


def five_by_four_text(name: str = "cdsm") -> str:
    """The same as an arm file's content."""
    return yaml.safe_dump(five_by_four(name).model_dump(), sort_keys=False)
