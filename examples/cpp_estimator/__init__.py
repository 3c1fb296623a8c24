"""The estimator in C++, with ONNX Runtime alone."""
