"""Independent simulators of arms and robots, which share no code with what is tested on them."""
