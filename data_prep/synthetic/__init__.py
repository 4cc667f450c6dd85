"""Phantoms, articulated figures and random organs, with known correspondences."""
