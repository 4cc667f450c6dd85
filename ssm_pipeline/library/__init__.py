"""The Python API on arrays in memory."""
