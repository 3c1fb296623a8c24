"""Public names; `__init__.py` imports each when it is first used."""

from .answer import Answer as Answer
from .estimation import Estimation as Estimation
from .known_machine import KnownMachine as KnownMachine
from .known_machine import Touch as Touch
from .models import LoadedModel as LoadedModel
from .models import load_model as load_model
from .replay import Comparison as Comparison
from .replay import RecordedRun as RecordedRun
from .replay import replay_in_process as replay_in_process
from .settings import EstimationSettings as EstimationSettings
