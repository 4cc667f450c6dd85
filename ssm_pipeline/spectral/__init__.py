"""A mesh → its Laplacian eigenpairs, gradient operators and wave kernel signature."""
