"""What knows no railway: errors, checks of arguments, units, files of numbers, batches, compilation, text and style of figures.

Imports nothing of railjax; every room may import it."""
