"""YAML as data: a mapping of plain values, its model, and what is wrong with it in a single line.

No tags, so nothing is ever constructed but text, numbers, booleans, dates, lists and mappings; no
aliases and no merging, which nest without end; no key twice, where PyYAML would take the last; no
scalar or nesting so large that reading it takes longer than the file's size suggests.
"""

from __future__ import annotations

import re
import reprlib
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from cablesense_base import CableSenseError

MAX_SCALAR_CHARACTERS = 1_000
"""Whole numbers are longer in other bases: one of 5,000 digits takes PyYAML seconds."""

MAX_DEPTH = 20
"""The deepest file here has five levels."""

_SHOWN_CHARACTERS = 60

_ModelT = TypeVar("_ModelT", bound=BaseModel)


class FilePart(BaseModel):
    """A part of a file: every key known, every number finite."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, protected_namespaces=()
    )


def _not_a_boolean(value: Any) -> Any:
    """Python counts `true` as 1; a person who writes it has put it under the wrong key."""
    if isinstance(value, bool):
        raise ValueError(f"= {value}: must be a number")
    return value


Number = Annotated[float, BeforeValidator(_not_a_boolean)]
Count = Annotated[int, BeforeValidator(_not_a_boolean)]


def read_plain(
    text: str, source: str, model: type[_ModelT], refusal: type[CableSenseError]
) -> _ModelT:
    """The `model` that YAML text describes; errors name its `source`.

    Raises:
        CableSenseError: of the class `refusal`: no plain YAML, an unknown key, or a value that
            cannot be true.
    """
    content = parse_plain_mapping(text, source, ", ".join(model.model_fields), refusal)
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise refusal(f"{source}: {describe_problem(error, model)}") from None


def parse_plain_mapping(
    text: str, source: str, keys: str, refusal: type[CableSenseError]
) -> dict[str, Any]:
    """The mapping that YAML text holds; errors name its `source` and the `keys` of such a mapping.

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
            long = f"{len(event.value)} characters; at most {MAX_SCALAR_CHARACTERS} can be meant"
            self.refuse(f"a value of {long}", event.start_mark)
        if self.depth >= MAX_DEPTH:
            nested = f"lists and mappings nested deeper than {MAX_DEPTH} levels"
            self.refuse(nested, event.start_mark)
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


_UNITS = {
    "_n_m_s": "N·m·s/rad", "_m_s2": "m/s²", "_n_m": "N/m", "_kg": "kg", "_hz": "Hz", "_n": "N",
    "_m": "m",
}  # fmt: skip
"""Units by the end of a key; the first that fits counts."""

_MESSAGES = {
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "finite_number": "must be a finite number",
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("list_type", "tuple_type"), "must be a list"),
    "literal_error": "must be {expected}",
    "string_type": "must be text",
    "string_pattern_mismatch": "must be 1 to 64 letters, digits, _ or -",
}
_NUMBER_MESSAGES = ("must be a number", "must be a finite number")

_shorten = reprlib.Repr()
_shorten.maxlevel, _shorten.maxlist, _shorten.maxdict = 2, 4, 4


def describe_problem(error: ValidationError, root: type[BaseModel]) -> str:
    """One line on the first problem of what `root` refused, and how many more keys have one."""
    problems: dict[str, Any] = {}
    for problem in error.errors(include_url=False):
        if _is_of_the_branch_meant(problem):
            problems.setdefault(_key(problem), problem)
    key, problem = next(iter(problems.items()))
    line = f"{key} {_message(key, problem, root)}".strip()
    if len(problems) > 1:
        line += f" (and {len(problems) - 1} more)"
    return " ".join(line.split())


def _message(key: str, problem: Any, root: type[BaseModel]) -> str:
    kind, location = problem["type"], problem["loc"]
    if kind == "extra_forbidden":
        return f"is no known key; valid keys here: {', '.join(_keys_of(root, location[:-1]))}"
    if kind == "missing" and isinstance(location[-1], int):
        return "is missing: the list is too short"
    if kind == "missing":
        return f"is missing; keys here: {', '.join(_keys_of(root, location[:-1]))}"
    if kind == "value_error":
        return str(problem["ctx"]["error"])
    value = _shorten.repr(problem["input"])  # a text or a nest of lists may have no end
    if kind == "model_type":
        return f"= {value}: must be a mapping with the keys {', '.join(_keys_of(root, location))}"
    if kind in _MESSAGES:
        text = _MESSAGES[kind].format(**problem.get("ctx", {}))
    else:
        text = problem["msg"][0].lower() + problem["msg"][1:]
    written = re.sub(r"\.\d+$", "", key)  # without the position in a list
    unit = next((unit for end, unit in _UNITS.items() if written.endswith(end)), None)
    if unit and (kind.startswith(("greater", "less")) or text in _NUMBER_MESSAGES):
        text += f", in {unit}"
    return f"= {value}: {text}"


def _key(problem: Any) -> str:
    location = problem["loc"]
    last = len(location) - 1 if problem["type"] == "extra_forbidden" else len(location)
    written = [part for i, part in enumerate(location) if i == last or not _is_type_tag(part)]
    return ".".join(
        part if isinstance(part, str) and part.isidentifier() else _shorten.repr(part)
        for part in written
    )


def _is_type_tag(part: object) -> bool:
    """Pydantic inserts the branch of a union into the location; a person did not write it."""
    return isinstance(part, str) and part.startswith(("constrained-", "function-", "list["))


def _is_of_the_branch_meant(problem: Any) -> bool:
    """Where one number or a list may stand, pydantic reports on both; only one was meant."""
    location = problem["loc"]
    if not location or not _is_type_tag(location[-1]):
        return True
    return str(location[-1]).startswith("list[") == isinstance(problem["input"], list)


def _keys_of(root: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    model = root
    for part in location:
        if isinstance(part, int):  # an item of a list, whose type has been taken already
            continue
        annotation = model.model_fields[str(part)].annotation
        annotation = next(iter(get_args(annotation)), annotation)
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            break
        model = annotation
    return list(model.model_fields)
