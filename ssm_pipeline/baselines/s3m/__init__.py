"""S3M (Bastian et al. 2023), the baseline, written from its description."""
