"""Features of a surface, soft maps and functional maps between two, and the spectral loss."""
