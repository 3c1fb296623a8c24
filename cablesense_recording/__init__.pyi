"""Public names; `__init__.py` imports each when it is first used."""

from .checks import check_recording as check_recording
from .column_map import ColumnMap as ColumnMap
from .column_map import read_column_map as read_column_map
from .csv_file import write_csv as write_csv
from .reading import read_recording as read_recording
from .recording import Finding as Finding
from .recording import Recording as Recording
from .recording import RecordingError as RecordingError
