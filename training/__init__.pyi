"""Public names; `__init__.py` imports each when it is first used."""

from .data.dataset import Dataset as Dataset
from .data.generation import draw_dataset as draw_dataset
from .data.parquet import read_dataset as read_dataset
from .data.parquet import write_dataset as write_dataset
from .data.protocols import MultiContact as MultiContact
from .data.protocols import SingleContact as SingleContact
from .errors import DatasetError as DatasetError
from .errors import TrainingError as TrainingError
from .law_export import export_law as export_law
from .model_training import draw_training_data as draw_training_data
from .model_training import train_model as train_model
