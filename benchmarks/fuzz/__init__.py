"""What `benchmarks/fuzz.py` throws at the readers of CableSense, and how it watches them."""
