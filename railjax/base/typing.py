"""Names for the annotations used throughout."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

#: What a function accepts as a number: a float, or an array with one value per lane of a batch (trailing axes).
Scalar = float | int | np.floating | Float[Array, "..."] | Float[np.ndarray, "..."]

#: The same as a field of a pytree. Not checked: JAX rebuilds pytrees with tracers, placeholders and None.
Number = Any

#: Numbers or arrays of NumPy or of JAX, whichever a namespace handed in makes of them (`namespace`). Not checked.
Values = Any
