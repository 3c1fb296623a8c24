"""Datasets, networks, training, evaluation, model files and the estimator that runs them.

What a user takes from here; each name is imported when it is first asked for, so that an estimator
needs no PyTorch and a dataset in memory no Parquet library:

    estimator = open_estimator(find_model("cdsm"), load_arm("my_arm.yaml"))
    contact = estimator.estimate(tension_difference_n, joint_command_rad)
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
