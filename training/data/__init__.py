"""Datasets and sequences: their protocols, generation on any number of workers, Parquet files."""
