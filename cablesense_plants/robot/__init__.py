"""Robots with hidden changes, simulated by independent rigid-body code."""
