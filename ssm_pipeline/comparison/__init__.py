"""Produce and score each method that a study compares."""
