"""Poses between two shapes: the network that moves one towards the other, and the spatial loss."""
