"""Robots with something hidden in them, simulated by rigid-body code of their own."""
