"""YAML changed as the tree it is: values, keys and branches."""

from __future__ import annotations

import copy
import random
from typing import Any

import yaml

VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 10**40, -0.0, 1e-320, 1e308, -1e308,
    float("nan"), float("inf"), float("-inf"), "", "x", "x" * 5_000, "a\nb", "\u202e", "nan", [],
    {}, [[]], [1, [2, [3]]], [0.1] * 300, {"a": {"b": 1}}, {1: 2}, "../up.dbc", "1e5", "0x10",
)  # fmt: skip


def mutated_yaml(rng: random.Random, text: str) -> bytes:
    """Between one and three changes of the tree that `text` holds, written anew."""
    tree = yaml.safe_load(text)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        _change(rng, tree)
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True).encode(
        "utf-8", errors="surrogatepass"
    )


def _change(rng: random.Random, tree: Any) -> None:
    holder, key = rng.choice(list(_places(tree)))
    action = rng.randrange(7)
    if action <= 2:
        holder[key] = copy.deepcopy(rng.choice(VALUES))
    elif action == 3:
        value = holder[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        holder[key] = value * rng.choice((-1, 0.5, 2, 1e3, 1e-3, 1e9)) if number else [value]
    elif action == 4:
        del holder[key]
    elif action == 5 and isinstance(holder, dict):
        holder[rng.choice(("", "x", f"{key}_", 3))] = holder.pop(key)
    else:
        for _ in range(rng.choice((1, 5, 60))):
            holder[key] = [holder[key]] if rng.random() < 0.5 else {"a": holder[key]}
    if isinstance(tree, dict) and not tree:
        tree["x"] = 1


def _places(tree: Any) -> Any:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, dict | list):
            yield from _places(value)
