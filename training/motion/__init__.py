"""The arm in motion: sequences of samples whose past counts, drawn and simulated for training."""
