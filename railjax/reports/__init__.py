"""Pages for readers: of one vehicle, and of the paper's reproduction.

Imports everything but the command line."""
