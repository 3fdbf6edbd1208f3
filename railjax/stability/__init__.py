"""The linear critical speed, modes and root loci about straight running.

Imports base, model and simulation."""
