"""Studies over grids and samples: points, workers, a store that can be continued.

Imports everything from base to tuning."""
