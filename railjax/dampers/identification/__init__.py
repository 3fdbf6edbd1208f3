"""From a test record to a damper: reading, least squares, what is known how well.

Imports base, model and the laws of dampers."""
