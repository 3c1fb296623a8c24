"""The gap between Table II's physical rows and the simulation, and what 54 numbers say of it."""
