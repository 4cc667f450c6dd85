"""Benchmarks and parameter studies."""
