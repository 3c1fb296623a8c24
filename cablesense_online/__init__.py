"""All that runs beside a live arm and needs no ROS: estimation, CAN, sensors, control, replay.

What a program that estimates contacts needs stands here by short names::

    from cablesense_online import Estimation, EstimationSettings, load_model

    loaded = load_model("cdsm", "")
    settings = EstimationSettings(contact_threshold=0.5, ...)
    estimation = Estimation(loaded.arm, loaded.estimator, settings, time.monotonic())
    answer = estimation.sample(serialized_joint_state, time.time_ns(), time.monotonic())

A name is imported when it is first used, so that `import cablesense_online` itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablesense_online.estimation import Answer as Answer
    from cablesense_online.estimation import Estimation as Estimation
    from cablesense_online.models import LoadedModel as LoadedModel
    from cablesense_online.models import load_model as load_model
    from cablesense_online.recorded_run import RecordedRun as RecordedRun
    from cablesense_online.replay import Comparison as Comparison
    from cablesense_online.replay import replay_in_process as replay_in_process
    from cablesense_online.state import EstimationSettings as EstimationSettings
    from cablesense_online.state import EstimatorState as EstimatorState

_MODULES = {
    "estimation": ("Answer", "Estimation"),
    "models": ("LoadedModel", "load_model"),
    "recorded_run": ("RecordedRun",),
    "replay": ("Comparison", "replay_in_process"),
    "state": ("EstimationSettings", "EstimatorState"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
