"""The paper's figures and claims, and what goes beyond it, a chapter a module.

Imports everything but the command line."""
