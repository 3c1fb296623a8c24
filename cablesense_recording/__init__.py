"""Recordings of an arm: commands, known loads, and readings.

    from cablesense_recording import read_recording
    from cablesense_sim import open_arm

    recording = read_recording("recording.mcap", open_arm("cdsm_lab"))

`recording` is one in memory, `csv_file` and `mcap_file` read and write it, `reading` takes
the reader by the file, and `checks` says what is wrong with one. A name is imported when it is
first used, so that `import cablesense_recording` itself costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
