"""Datasets, networks, training, evaluation, model files and the estimator that runs them."""
