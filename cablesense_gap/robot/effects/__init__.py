"""Effects of a robot, in modules by what they act on; `catalogue.known_effects` finds them."""
