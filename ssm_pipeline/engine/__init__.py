"""Run stages: keys, cache, resume, per-case work in processes, ownership, terminal.

The engine knows nothing about shapes: a stage is a function that reads files and writes files.
"""
