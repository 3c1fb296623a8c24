"""The report of a diagnosis: one page that stands alone, with the verdict in its first line."""
