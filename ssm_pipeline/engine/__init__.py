"""Runs stages: keys, cache, resume, per-case work in processes, ownership, terminal.

Knows nothing of shapes: a stage is a function that reads files and writes files.
"""
