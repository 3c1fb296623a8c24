"""The parts of `soak.py`: the course of tensions, the amplifiers, the sink, the figures."""
