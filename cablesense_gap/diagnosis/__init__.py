"""Which effect makes the gap: candidates are fitted on some trials and scored on others."""
