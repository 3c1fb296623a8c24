"""Datasets, networks, training, evaluation, model files and the estimator that runs them.

What a user takes from here; each name is imported when it is first asked for, so that an estimator
needs no PyTorch and a dataset in memory no Parquet library:

    export_law(load_arm("my_arm.yaml"), Path("my_arm.onnx"), command="")
    law = LawModel("my_arm.onnx", load_arm("my_arm.yaml"))
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
