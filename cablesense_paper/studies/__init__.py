"""The studies of the paper, one file each. Each has one `STUDY`, named as its file."""
