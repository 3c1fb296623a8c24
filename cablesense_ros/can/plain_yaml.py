"""YAML as data: plain values only, no alias, no key twice."""

from __future__ import annotations

from typing import Any

import yaml

from cablesense_ros.can.channel_map import ChannelMapError


def parse_plain_mapping(text: str, source: str, keys: str) -> dict[str, Any]:
    """The mapping that YAML text holds.

    Args:
        text: of the file.
        source: its name, for errors.
        keys: those that belong in it, for errors.

    Raises:
        ChannelMapError: not such YAML, or no mapping.
    """
    try:
        content = yaml.load(text, Loader=_PlainLoader)
    except (yaml.YAMLError, RecursionError, ValueError, LookupError, AttributeError) as error:
        # the last three: what Python makes of tags such as `!!int x`, which PyYAML lets through
        line = " ".join(str(error).split())
        raise ChannelMapError(f"{source}: not valid YAML ({line[:300]})") from error
    if not isinstance(content, dict):
        raise ChannelMapError(
            f"{source}: holds {type(content).__name__}, not a mapping with the keys {keys}"
        )
    return content


class _PlainLoader(yaml.SafeLoader):
    """No key twice, where PyYAML would take the last; no alias, which can nest without end."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(
                None, None, "an alias (*name): write the value out", mark
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key.value[:40]!r} stands twice", key.start_mark
                )
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)
