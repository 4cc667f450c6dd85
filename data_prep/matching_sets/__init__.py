"""Published shape matching benchmarks, in the layouts they are distributed in."""
