"""Datasets: the paper's protocols, their generation on any number of workers, Parquet files."""
