"""What the report of a vehicle says, a section a module.

Imports everything but the command line."""
