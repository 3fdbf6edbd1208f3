"""Limit cycles: shooting, folds, the nonlinear critical speed, bifurcation diagrams, and their derivatives.

Imports base, model, simulation and stability."""
