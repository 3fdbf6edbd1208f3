"""The command line, a verb a file in `verbs`: options in, one call of the library, text or JSON out.

Imports everything; nothing imports it.
"""

from .application import app, main, status

__all__ = ["app", "main", "status"]
