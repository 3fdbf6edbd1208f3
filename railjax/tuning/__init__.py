"""Changing a vehicle or a damper by gradients: objectives, constraints, fronts, gains over speed, calibration.

Imports everything from base to vehicles."""
