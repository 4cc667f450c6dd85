"""`python -m ssm_pipeline.cli`."""

from ssm_pipeline.cli import main

main()
