"""Pairs of shapes → trained networks: schedule, checkpoints, starting weights, template choice."""
