"""What a study is: its settings, the YAML they are read from, the cohort they name."""
