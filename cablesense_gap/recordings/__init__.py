"""Recordings of an arm: commands, known loads, and readings."""
