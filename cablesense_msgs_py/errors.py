"""The error family.

Every error that CableSense raises on purpose derives from `CableSenseError`, so that a command can
turn it into one line and a node into one log message::

    CableSenseError
    ├── ArmFileError        an arm file that cannot be true       (cablesense_sim.arm)
    ├── EquilibriumError    no static pose was found              (cablesense_sim.equilibrium)
    ├── LoadError           a load that the arm cannot bear       (cablesense_sim.loads)
    ├── ContractError       a message that breaks the contract    (cablesense_msgs_py)
    ├── DatasetError        a dataset that does not fit           (cablesense_training.data)
    └── ModelFileError      a model file that does not fit        (cablesense_training.inference)
"""


class CableSenseError(Exception):
    """Base of all errors raised on purpose: says what was wrong, where, and what is right."""
