"""What the command line and Python call: check, init, run, export, figures, benchmarks."""
