"""The demo: simulator, estimator and page as processes, and a script of pushes with a report."""
