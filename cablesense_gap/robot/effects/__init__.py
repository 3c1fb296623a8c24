"""One effect, one file; `catalogue.known_effects` finds them."""
