"""Verdicts against the answers that were withheld: how often right, how sure, how calibrated."""
