"""The report of one vehicle, a page of its own with its figures inside.

Imports everything but the command line."""
