"""The error family.

Every error that CableSense raises on purpose derives from `CableSenseError`, so that a command can
turn it into one line and a node into one log message::

    CableSenseError
    ├── ArmFileError        an arm file that cannot be true        cablesense_sim.arm
    ├── EquilibriumError    no static pose was found               cablesense_sim.equilibrium
    ├── LoadError           a load that the arm cannot bear        cablesense_sim.loads
    ├── ContractError       a message that breaks the contract     cablesense_msgs_py
    ├── DatasetError        a dataset that does not fit            cablesense_training.data
    ├── TrainingError       what cannot be trained with            cablesense_training
    ├── ModelFileError      a model file that does not fit         cablesense_training.inference
    ├── EstimateError       inputs that a model cannot take        cablesense_training.inference
    ├── RecordingError      a recording that cannot be used        cablesense_gap.recordings
    ├── VerdictError        a verdict that cannot be               cablesense_gap.verdict
    ├── ScoreError          what cannot be scored                  cablesense_gap.scoring
    ├── ReportError         a report that cannot be written        cablesense_gap.report
    ├── RetrainingError     no loads to judge an estimator by      cablesense_gap.retraining
    ├── PlantError          a plant that cannot be built or run    cablesense_gap.plant
    ├── PaperError          what cannot be reproduced              cablesense_paper
    ├── ParameterError      a node parameter out of place          cablesense_ros
    ├── SampleError         a sample that cannot be used           cablesense_online
    ├── TareError           a tare that cannot be taken            cablesense_online
    ├── ChannelMapError     a channel map or DBC that cannot be    cablesense_online.can
    ├── CanInterfaceError   a CAN interface that cannot be opened  cablesense_online.can
    ├── FaultRequestError   a fault that cannot be shown           cablesense_online.can
    ├── SlcanPortError      a pseudo-terminal that cannot be had   cablesense_online.can
    ├── PageError           a page that cannot be served           cablesense_online.page
    └── DemoError, ChildError, ScriptError   the demo's own        cablesense_ros.demo
"""


class CableSenseError(Exception):
    """Base of all errors raised on purpose: names what was wrong, where, and what is right."""
