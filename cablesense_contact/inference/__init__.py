"""Model files, and the estimators that nodes and evaluation use. No torch in here."""
