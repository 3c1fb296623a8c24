"""Public names; `__init__.py` imports each when it is first used."""

from .arm_system import Diagnosis as Diagnosis
from .arm_system import diagnose as diagnose
from .report.page import write_diagnosis as write_diagnosis
from .simulator import Candidate as Candidate
from .simulator import Simulator as Simulator
from .simulator import Term as Term
from .verdict import Verdict as Verdict
from .verdict import read_verdict as read_verdict
