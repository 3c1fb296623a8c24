"""Inference: model files, and the estimators that the nodes, the evaluation and the diagnosis use. No torch in here."""
