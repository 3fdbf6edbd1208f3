"""What the rails do: shapes, samples, random tracks of a spectrum, measured tracks.

Imports base and the vehicle's parameters."""
