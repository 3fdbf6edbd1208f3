"""The paper: studies that make its figures, numbers and statements, and the page that holds them.

Imports everything but the command line."""
