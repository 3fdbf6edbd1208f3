"""Running safety in the manner of EN 14363: criteria, signals, the assessment of a run or a record.

Imports base, model and simulation."""
