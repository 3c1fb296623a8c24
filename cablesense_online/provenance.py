"""Where the answers of a recorded estimator come from: model, settings, and from when on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from cablesense_msgs_py.topics import ContractError
from cablesense_online.settings import EstimationSettings

_MOST_CHARACTERS = 20_000
"""Of the text of a provenance: a longer one is none of ours."""


@dataclass(frozen=True)
class Beginning:
    """Of an estimator when it begins to use a calibration.

    Attributes:
        from_ns: time since the epoch.
        after_ns: stamp of the last sample that was answered by the calibration before; 0 if none.
        command_rad: (2N,) the command in force; of a machine (C,), rad or m.
        known: whether the unloaded state is known: by a tare, or by a calibration.
    """

    from_ns: int
    after_ns: int
    command_rad: tuple[float, ...]
    known: bool


@dataclass(frozen=True)
class Provenance:
    """What an estimator runs.

    Attributes:
        model, sha256: path of the model file, and what identifies it.
        arm: identity of the arm.
        frame_prefix: of its frames.
        settings: of the estimation.
    """

    model: str
    sha256: str
    arm: str
    frame_prefix: str
    settings: EstimationSettings

    def as_json(self, beginning: Beginning) -> str:
        """As text, with what held when it began."""
        return json.dumps(
            {
                "from_ns": beginning.from_ns,
                "after_ns": beginning.after_ns,
                "command_rad": list(beginning.command_rad),
                "known": beginning.known,
                "model": self.model,
                "sha256": self.sha256,
                "arm": self.arm,
                "frame_prefix": self.frame_prefix,
                "settings": self.settings.model_dump(),
            }
        )

    @classmethod
    def from_json(cls, text: str) -> tuple[Provenance, Beginning]:
        """From the text of `as_json`.

        Raises:
            ContractError: it is no such text.
        """
        try:
            if len(text) > _MOST_CHARACTERS:
                raise ValueError("too long")
            content: dict[str, Any] = json.loads(text)
            provenance = cls(
                model=str(content["model"]),
                sha256=str(content["sha256"]),
                arm=str(content["arm"]),
                frame_prefix=str(content["frame_prefix"]),
                settings=EstimationSettings.model_validate(content["settings"]),
            )
            command_rad = tuple(float(angle) for angle in content["command_rad"])
            beginning = Beginning(
                from_ns=int(content["from_ns"]),
                after_ns=int(content["after_ns"]),
                command_rad=command_rad,
                known=bool(content["known"]),
            )
        except Exception as error:  # JSON and pydantic have families of their own
            line = " ".join(str(error).split())[:200]
            raise ContractError(
                f"{text[:40]!r} does not state model and settings of an estimator ({line})"
            ) from error
        return provenance, beginning
