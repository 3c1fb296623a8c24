"""Recordings of an arm: what was commanded, what pushed it, and what the sensors read."""
