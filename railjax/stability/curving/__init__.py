"""Steady curving: equilibrium in an arc, what its wheels carry and wear, drawings.

Imports base, model, simulation and stability."""
