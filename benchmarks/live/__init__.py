"""Benchmarks of the live estimate."""
