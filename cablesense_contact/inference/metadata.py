"""The metadata of a model file, and the bundled model files found by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cablesense_base.installation import BundledFiles
from cablesense_contact.errors import ModelFileError
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of

FORMAT = "cablesense-model/1"
"""Name and version of the format; a reader refuses any other."""

UNITS = {
    "tension_difference_n": "N",
    "joint_command_rad": "rad",
    "contact_probability": "1",
    "direction": "1",
    "magnitude_n": "N",
    "magnitude_std_n": "N",
    "angle_std_deg": "deg",
}
"""Unit of every input and output of the paper's networks."""

ModelKind = Literal["single-contact", "multi-contact", "contact-anywhere"]
ANYWHERE: ModelKind = "contact-anywhere"
"""The kind of models whose contacts may be at any place."""

SINGLE_CONTACT: ModelKind = "single-contact"
"""The kind of models of one contact at the contact points of the arm file."""
MULTI_CONTACT: ModelKind = "multi-contact"
"""The kind of models of several contacts at once, with their magnitudes."""

REMOVED_NETWORKS = {
    "closed-form": "statics of one contact at the points of the arm file",
    "closed-form-corrected": "statics of one contact at the points of the arm file, corrected",
    "history-simulated": "the same beside a simulation of the arm's friction and creep",
    "multi-contact-closed-form": "statics of several contacts at the points of the arm file",
    "scale-aware": "one contact at the points of the arm file from tensions alone",
    "temporal": "statics corrected by a recurrent network, in motion and under friction",
}
"""Networks of earlier versions, and what they were."""

_KEY = "cablesense"
_Finite = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


def of_removed_network(name: str) -> str:
    """The sentence about a network that earlier versions had; empty of any other name."""
    if name not in REMOVED_NETWORKS:
        return ""
    return (
        f"network {name} was {REMOVED_NETWORKS[name]}; this version has one estimator for all "
        "that, which `cablesense export --arm` makes in seconds, without training"
    )


class ModelMetadata(BaseModel):
    """Purpose and origin of a model; one JSON text in the ONNX file's metadata.

    Attributes:
        kind: single contact with direction, several contacts with magnitudes, both at the contact
            points of the arm file; or the law of contacts anywhere.
        network: as `cablesense train --network` takes it, or `anywhere` of the law.
        arm_identity: name and hash of the arm.
        cable_names, joint_names: order of the inputs.
        pose_aware: whether the commanded joint angles are an input.
        pose_range_deg, force_range_n: joint angles within ± this and forces up to this were
            trained on.
        tare_samples: readings averaged into the unloaded state in training.
        effect_versions: of the laws of the arm's effects that it was trained on, if not 1.
        command, seed: what makes the file again.
        version: of CableSense.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: str = FORMAT
    kind: ModelKind
    network: str
    arm: Arm
    arm_identity: str
    cable_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    units: dict[str, str] = Field(default_factory=lambda: dict(UNITS))
    pose_aware: bool
    pose_range_deg: _Finite
    force_range_n: _Finite
    tare_samples: Annotated[int, Field(ge=1)]
    effect_versions: dict[str, Annotated[int, Field(ge=1)]] = Field(default_factory=dict)
    command: str
    seed: int
    version: str

    def to_properties(self) -> dict[str, str]:
        """As ONNX metadata properties."""
        left_out = set() if self.effect_versions else {"effect_versions"}
        # JSON has no infinity: pydantic writes a rigid actuator's stiffness as null
        content = json.loads(self.model_dump_json(exclude=left_out))
        return {_KEY: json.dumps(content, sort_keys=True, allow_nan=False)}

    @classmethod
    def from_properties(cls, properties: Mapping[str, str], source: str) -> ModelMetadata:
        """From ONNX metadata properties; a `ModelFileError` says what is wrong with them."""
        if _KEY not in properties:
            raise ModelFileError(
                f"{source}: an ONNX file, but not a CableSense model (no metadata {_KEY!r}); "
                "make one with `cablesense export`"
            )
        try:
            content = json.loads(properties[_KEY])
            if isinstance(content, dict) and content.get("format") != FORMAT:
                raise ModelFileError(
                    f"{source}: format {str(content.get('format'))[:80]!r}; this version reads "
                    f"{FORMAT!r}, so train the model again"
                )
            if isinstance(content, dict):
                removed = of_removed_network(str(content.get("network")))
                if removed:
                    raise ModelFileError(f"{source}: {removed}")
            metadata = cls.model_validate(_with_infinities(content))
        except (ValueError, ValidationError, RecursionError) as error:
            line = " ".join(str(error).split())[:200]
            raise ModelFileError(
                f"{source}: its metadata cannot be read ({line}); train the model again"
            ) from error
        if metadata.arm.identity != metadata.arm_identity:
            raise ModelFileError(
                f"{source}: states arm {metadata.arm_identity[:80]!r} but describes "
                f"{metadata.arm.identity}; the file was altered, so train the model again"
            )
        versions = effect_versions(metadata.arm)
        for name in sorted({*versions, *metadata.effect_versions}):
            trained_on = metadata.effect_versions.get(name, 1)
            version = versions.get(name, 1)
            if trained_on != version:
                raise ModelFileError(
                    f"{source}: trained on version {trained_on} of the law of {name}, which is "
                    f"simulated by version {version} now; train it again: {metadata.command[:400]}"
                )
        return metadata


def effect_versions(arm: Arm) -> dict[str, int]:
    """Versions of the laws of an arm's effects, but for first ones."""
    listed = {entry.effect.name: entry.effect.version for entry in entries_of(arm)}
    return {name: version for name, version in listed.items() if version > 1}


def _with_infinities(content: object) -> object:
    """A rigid actuator's stiffness, null in JSON, as it is."""
    if isinstance(content, dict) and isinstance(content.get("arm"), dict):
        actuators = content["arm"].get("actuators")
        if isinstance(actuators, dict) and actuators.get("kp_n_m", 0.0) is None:
            actuators["kp_n_m"] = float("inf")
    return content


_BUNDLED = BundledFiles("model", "models", (".onnx",), ModelFileError)


def bundled_models() -> list[str]:
    """Names of the bundled models, for example `cdsm_anywhere`; the paper's are in `peers/`."""
    return _BUNDLED.names()


def find_model_of(arm: Arm, arm_file: str, model: str = "") -> Path:
    """The model file of a name or a path; by default the arm's bundled one, of contacts anywhere.

    Raises:
        ModelFileError: as `find_model`, or no model is bundled for the arm.
    """
    name = f"{arm.name}_anywhere"
    if not model and name not in bundled_models():
        raise ModelFileError(
            f"no model is bundled for arm {arm.name}: make one with `cablesense export --arm "
            f"{arm_file} --out {arm.name}.onnx`, and give it as the model (--model "
            f"{arm.name}.onnx)"
        )
    return find_model(model or name)


def find_model(name_or_path: str | Path) -> Path:
    """The model file of a name (`cdsm_anywhere`) or a path (`my.onnx`).

    Raises:
        ModelFileError: neither a bundled model nor a file; the message lists the bundled names.
    """
    return _BUNDLED.find(name_or_path)
