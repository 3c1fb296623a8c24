"""What benchmarks of running nodes share: processes, their figures, the file of a result."""
