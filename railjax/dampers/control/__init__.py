"""Controllers as they are built: sensors, estimators, the sampled loop with its faults, and laws that learn.

Imports base, model and the laws of dampers."""
