"""Wheel and rail: creepage, creep forces and their saturation, gravitational stiffness, the flange; Kalker's coefficients.

Imports base and the vehicle's parameters."""
