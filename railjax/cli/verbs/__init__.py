"""One verb a module: its options, and one call of the library.

Imports everything."""
