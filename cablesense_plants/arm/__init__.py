"""An independent plant: the "real arm" that the diagnosis is tried on without knowing it.

It shares no code and no solver with the simulator or with the diagnosis, and has its own forms of
the effects. Nothing of the diagnosis may import it.
"""
