"""The parts of `kill.py`: the load, the watcher, a kill and its figures."""
