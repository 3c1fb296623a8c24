"""Independent simulators of arms and robots, which share no code with the diagnosis."""
