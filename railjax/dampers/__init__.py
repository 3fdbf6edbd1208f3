"""Secondary lateral dampers beyond the vehicle's own, a family of laws a module; all of them by name.

Imports base and model."""
