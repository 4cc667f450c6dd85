"""Read cohorts from files, and generate synthetic ones.

The code imports this folder as `ssm_pipeline.data_prep`: a link in a checkout, a folder in a wheel.
"""
