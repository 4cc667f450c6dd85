"""Readers of image, surface and segment files: one module per format."""
