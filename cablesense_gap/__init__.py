"""A recording against a simulator: where the gap lies, what causes it, how far it shrinks."""
