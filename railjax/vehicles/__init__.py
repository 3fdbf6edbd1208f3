"""Packaged vehicles (.toml), and vehicles from and to files, checked.

Imports base, model, simulation and stability."""
