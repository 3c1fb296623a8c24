"""YAML as data: a mapping of plain values, and nothing else that YAML can say.

No tags, so nothing is ever constructed but text, numbers, booleans, dates, lists and mappings; no
aliases and no merging, which nest without end; no key twice, where PyYAML would take the last; no
scalar or nesting so large that reading it takes longer than the file's size says.
"""

from __future__ import annotations

from typing import Any

import yaml

from cablesense_msgs_py.errors import CableSenseError

MAX_SCALAR_CHARACTERS = 1_000
"""Whole numbers are longer in other bases: one of 5,000 digits takes PyYAML seconds."""

MAX_DEPTH = 20
"""The deepest file here has five levels."""

_SHOWN_CHARACTERS = 60


def parse_plain_mapping(
    text: str, source: str, keys: str, refusal: type[CableSenseError]
) -> dict[str, Any]:
    """The mapping that YAML text holds.

    Args:
        text: of the file.
        source: its name, for errors.
        keys: those that belong in it, for errors.
        refusal: the error to raise.

    Raises:
        CableSenseError: of the class `refusal`: not such YAML, or no mapping.
    """
    try:
        content = yaml.load(text, Loader=_PlainLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{source}: line {mark.line + 1}" if mark else source
        raise refusal(f"{where}: not plain YAML ({_line(error.problem or error)})") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        # ValueError: dates such as 2020-99-99, and what no number can be made of
        raise refusal(f"{source}: not plain YAML ({_line(error)})") from error
    if not isinstance(content, dict):
        raise refusal(
            f"{source}: holds {type(content).__name__}, not a mapping with the keys {keys}"
        )
    return content


def _line(error: object) -> str:
    return " ".join(str(error).split())[:200]


class _PlainLoader(yaml.SafeLoader):
    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            self.refuse("an alias (*name); write the value out", event.start_mark)
        if getattr(event, "tag", None) is not None:
            self.refuse(f"a tag ({_short(event.tag)}); write the plain value", event.start_mark)
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_SCALAR_CHARACTERS:
            self.refuse(
                f"a value of {len(event.value)} characters; at most {MAX_SCALAR_CHARACTERS} "
                "can be meant",
                event.start_mark,
            )
        if self.depth >= MAX_DEPTH:
            self.refuse(
                f"lists and mappings nested deeper than {MAX_DEPTH} levels", event.start_mark
            )
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                self.refuse("a list or mapping as a key; a key is one word", key.start_mark)
            if key.tag == "tag:yaml.org,2002:merge":
                self.refuse("a merge (<<); write the keys out", key.start_mark)
            if key.value in seen:
                self.refuse(f"key {_short(key.value)} stands twice; give it once", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def refuse(self, what: str, mark: Any) -> None:
        raise yaml.constructor.ConstructorError(None, None, what, mark)


def _short(text: str) -> str:
    return repr(text[:_SHOWN_CHARACTERS])
