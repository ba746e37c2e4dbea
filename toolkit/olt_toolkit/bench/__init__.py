"""The frame of the benchmarks: error against run time."""
