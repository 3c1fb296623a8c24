"""Which effect makes the gap: candidates are fitted on some trials and judged on others."""
