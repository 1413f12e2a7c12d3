"""What unit tests, end-to-end tests, soak, fuzz and benchmarks share."""
