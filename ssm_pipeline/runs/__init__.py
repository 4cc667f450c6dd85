"""The files of a run, a run read back, and the context that every stage receives."""
