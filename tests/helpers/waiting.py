"""Tests wait here for what another thread or process does."""

import time


def until(condition, what="a condition", within_s=60.0):
    """What the condition gives, once that is true."""
    end_s = time.monotonic() + within_s
    while not (found := condition()):
        assert time.monotonic() < end_s, f"waited {within_s:g} s in vain for {what}"
        time.sleep(0.002)
    return found
