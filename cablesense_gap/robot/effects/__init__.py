"""Effects of a robot; `amending.known_effects` finds them."""
