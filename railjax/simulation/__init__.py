"""Running in time: RK4 with its largest step, batches of runs, channels, results.

Imports base and model."""
