"""YAML as data: a mapping of plain values, its model, and its first error in a single line.

Only text, numbers, booleans, dates, lists and mappings are constructed. Aliases, tags, a key that
stands twice, and values or nesting without end are refused.
"""

from __future__ import annotations

import reprlib
from difflib import get_close_matches
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from cablesense_base import CableSenseError

MAX_SCALAR_CHARACTERS = 1_000
"""Whole numbers are longer in other bases: one of 5,000 digits takes PyYAML seconds."""

MAX_DEPTH = 20
"""The deepest file here has five levels."""

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
            _refuse("an alias (*name); write the value out", event)
        if getattr(event, "tag", None) is not None:
            _refuse(f"a tag ({event.tag[:60]!r}); write the plain value", event)
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_SCALAR_CHARACTERS:
            _refuse(f"a value of more than {MAX_SCALAR_CHARACTERS} characters", event)
        if self.depth >= MAX_DEPTH:  # PyYAML takes ever longer the deeper it goes
            _refuse(f"lists and mappings nested deeper than {MAX_DEPTH} levels", event)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key.value, str) and key.value in seen:
                _refuse(f"key {key.value[:60]!r} stands twice; give it once", key)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)


def _refuse(what: str, where: Any) -> None:
    raise yaml.constructor.ConstructorError(None, None, what, where.start_mark)


_UNKNOWN = "extra_forbidden"
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
"""Pydantic's kinds of error in the words of a file."""


def describe_problem(error: ValidationError, root: type[BaseModel]) -> str:
    """One line on the first problem of what `root` refused, and how many more keys have one."""
    problems: dict[str, Any] = {}
    for problem in error.errors(include_url=False):
        if _is_of_the_branch_meant(problem):
            problems.setdefault(_key(problem), problem)
    # a key that is written wrongly is missing too
    problems = dict(sorted(problems.items(), key=lambda each: each[1]["type"] != _UNKNOWN))
    key, problem = next(iter(problems.items()))
    line = f"{key} {_message(problem, root)}"
    if len(problems) > 1:
        line += f" (and {len(problems) - 1} more)"
    return " ".join(line.split())


def _message(problem: Any, root: type[BaseModel]) -> str:
    kind = problem["type"]
    location = problem["loc"]
    value = reprlib.repr(problem["input"])  # a text or a nest of lists may have no end
    if kind == _UNKNOWN:
        keys = _keys_of(root, location[:-1])
        meant = get_close_matches(str(location[-1])[:80], keys.split(", "), 1)
        question = f"is {meant[0]} meant? " if meant else ""
        return f"is no known key; {question}valid keys here: {keys}"
    if kind == "missing" and isinstance(location[-1], int):
        return "is missing: the list is too short"
    if kind == "missing":
        return f"is missing; keys here: {_keys_of(root, location[:-1])}"
    if kind == "value_error":
        return str(problem["ctx"]["error"])
    if kind == "model_type":
        return f"= {value}: must be a mapping with the keys {_keys_of(root, location)}"
    if kind in _MESSAGES:
        return f"= {value}: {_MESSAGES[kind].format(**problem.get('ctx', {}))}"
    return f"= {value}: {problem['msg'][0].lower() + problem['msg'][1:]}"


def _key(problem: Any) -> str:
    *before, last = problem["loc"] or ("",)
    written = [part for part in before if not _is_type_tag(part)]
    if problem["type"] == _UNKNOWN or not _is_type_tag(last):
        written.append(last)
    return ".".join(
        part if isinstance(part, str) and (part.isidentifier() or not part) else reprlib.repr(part)
        for part in written
    )


def _is_type_tag(part: object) -> bool:
    """Pydantic inserts the branch of a union into the location; a person did not write it."""
    return isinstance(part, str) and part.startswith(("constrained-", "function-", "list["))


def _is_of_the_branch_meant(problem: Any) -> bool:
    """Pydantic reports on both branches of a number or list; the user meant one of them."""
    last = problem["loc"][-1] if problem["loc"] else ""
    return not _is_type_tag(last) or last.startswith("list[") == isinstance(problem["input"], list)


def _keys_of(root: type[BaseModel], location: tuple[int | str, ...]) -> str:
    model: Any = root
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            annotation = model.model_fields[part].annotation
            kinds = (annotation, *get_args(annotation))  # the latter of a list or mapping
            model = next((kind for kind in kinds if hasattr(kind, "model_fields")), model)
    return ", ".join(model.model_fields)
