"""A residual taken apart: in which cables, at which loads and poses, and when the gap is large."""
