"""`python -m ssm_pipeline` is the `workflow` command."""

from ssm_pipeline.cli import main

main()
