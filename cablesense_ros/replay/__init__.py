"""A recorded run once more: through the same code, or through a live node."""
