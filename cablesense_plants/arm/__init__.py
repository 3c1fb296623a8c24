"""An arm that the diagnosis is tried on without knowing it: own solver, own forms of effects."""
