"""Public names; `__init__.py` imports each when it is first used."""

from .calibration import Calibration as Calibration
from .calibration import CalibrationError as CalibrationError
from .calibration import Calibrator as Calibrator
from .calibration import Unloaded as Unloaded
from .calibration_file import read_calibration as read_calibration
from .calibration_file import write_calibration as write_calibration
from .errors import EstimateError as EstimateError
from .errors import ModelFileError as ModelFileError
from .estimate import ContactPlace as ContactPlace
from .estimate import Estimate as Estimate
from .felt_arm import FeltArm as FeltArm
from .inference.estimator import Estimates as Estimates
from .inference.estimator import Estimator as Estimator
from .inference.estimator import MultiEstimator as MultiEstimator
from .inference.law_model import LawModel as LawModel
from .inference.metadata import find_model as find_model
from .judgement import ContactState as ContactState
from .judgement import Judge as Judge
from .judgement import Judgement as Judgement
from .judgement import Judgements as Judgements
from .law import Law as Law
from .law import LawOutput as LawOutput
