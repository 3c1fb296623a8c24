"""What is made of an arm file: its URDF, a template to start from, the reference of its keys."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer
from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo

from cablesense_base.files import OutputError, output_file, write_atomically
from cablesense_base.installation import config_path
from cablesense_ros.cli.options import ForceOption
from cablesense_sim.arm import Arm, find_arm, load_arm

_TEMPLATE = "arm_template.yaml"
_UNITS = {
    "_n_m_s": "N·m·s", "_m_s2": "m/s²", "_n_m": "N/m", "_deg": "°", "_hz": "Hz", "_kg": "kg",
    "_m": "m", "_n": "N",
}  # fmt: skip
_OTHERWISE = {
    "cables.axial_rigidity_n": "E·A of the cable alone, in place of `stiffness_n_m`",
    "effects": "what the arm does beyond the ideal (docs/effects.md)",
}


def urdf(
    arm: Annotated[
        str, typer.Argument(help="Arm file: a path, or a bundled arm's name.")
    ] = "cdsm",
    out: Annotated[
        Path | None, typer.Option(help="Write it to this file.", show_default="standard output")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write the URDF of an arm: links, joints, inertia, and shapes to see and to collide with.

    Joints have the names of joint_states; cables have no place in a URDF.

    Example: cablesense urdf my_arm.yaml --out my_arm.urdf
    """
    from cablesense_sim.model import urdf_xml

    file = find_arm(arm)
    if out is None:
        print(urdf_xml(load_arm(file)))
        return
    output_file(out, force=force, inputs=(file,))
    write_atomically(out, urdf_xml(load_arm(file)) + "\n", OutputError)


def arm_template() -> str:
    """An arm file to start from, whose comments stay true whatever its numbers become."""
    return config_path(_TEMPLATE).read_text(encoding="utf-8")


def arm_keys_markdown() -> str:
    """A Markdown table of every key: unit, what is valid, default, meaning."""
    said = dict(_comments(arm_template())) | _OTHERWISE
    rows = ["| key | unit | valid | default | what |", "| --- | --- | --- | --- | --- |"]
    for key, field in _fields(Arm):
        unit = next((unit for end, unit in _UNITS.items() if key.endswith(end)), "")
        if key.startswith("cables.angle_deg."):
            unit = "°"
        default = "" if field.is_required() else _shown(field.get_default())
        rows.append(f"| `{key}` | {unit} | {_valid(field)} | {default} | {said.get(key, '')} |")
    return "\n".join(rows)


def _comments(text: str) -> Iterator[tuple[str, str]]:
    """Full key and comment of each line of a YAML file of nested mappings."""
    path: list[str] = []
    for line in text.splitlines():
        found = re.match(r"( *)(\w+):[^#]*(?:# (.*))?$", line)
        if found:
            path[len(found[1]) // 2 :] = [found[2]]
            yield ".".join(path), found[3] or ""


def _fields(part: type[BaseModel], before: str = "") -> Iterator[tuple[str, FieldInfo]]:
    for name, field in part.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from _fields(kind, f"{before}{name}.")
        else:
            yield f"{before}{name}", field


def _shown(default: Any) -> str:
    if not isinstance(default, bool | int | float | tuple):
        return "none"
    return f"`{list(default)}`" if isinstance(default, tuple) else f"`{str(default).lower()}`"


def _valid(field: FieldInfo) -> str:
    schema = TypeAdapter[Any](cast(Any, field.annotation)).json_schema()
    lists = any(
        each.get("type") == "array" for each in schema.get("anyOf", ()) if field.is_required()
    )
    each = ", or a list with one for each segment" if lists else ""
    return _described(schema) + _bounds([field.annotation, *field.metadata]) + each


def _described(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return _described(schema["anyOf"][0])
    if "const" in schema:
        return f"`{str(schema['const']).lower()}`"
    kind = schema.get("type")
    if kind == "array":
        if "prefixItems" in schema:
            return "list of " + ", ".join(_described(each) for each in schema["prefixItems"])
        return "list"
    return {"integer": "whole number", "string": "text"}.get(str(kind), str(kind))


def _bounds(parts: Iterable[Any]) -> str:
    """The first bounds found in a type and its annotations."""
    low = high = ""
    for part in parts:
        for name, words in (("gt", " above {:g}"), ("ge", " from {:g}")):
            if (bound := getattr(part, name, None)) is not None:
                low = words.format(bound)
        if (bound := getattr(part, "le", None)) is not None:
            high = f" to {bound:g}" if not low.startswith(" above") else f", to {bound:g}"
        inner = [*get_args(part), *getattr(part, "metadata", ())]
        if not (low or high) and inner:
            found = _bounds(inner)
            if found:
                return found
    return low + high
