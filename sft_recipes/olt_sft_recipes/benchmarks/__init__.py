"""Benchmarks of tokens, precision and the flow of the toy policy."""
