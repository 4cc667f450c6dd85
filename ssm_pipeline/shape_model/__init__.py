"""Correspondences → corresponded shapes → alignment, principal components, the shape model."""
