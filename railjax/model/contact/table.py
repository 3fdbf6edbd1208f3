"""The smooth contact geometry as the equations of motion read it: one row of cubics per step of y, differentiable and twice continuous."""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import Kind
from ...base.errors import InputError
from ...base.typing import Number
from .cubics import cubic_rows
from .geometry import ContactGeometry

Wheelsets = Float[Array, "..."]

#: functions of a table, in the order of its rows
FUNCTIONS = ("delta_r", "angle_right", "angle_left", "roll", "curvature_right", "curvature_left")


class ContactAt(NamedTuple):
    """What the contact is at a displacement; of each function the value, and with `rates` its derivative by y."""

    delta_r: Wheelsets  # m
    angle_right: Wheelsets  # rad, against the axle
    angle_left: Wheelsets
    roll: Wheelsets  # rad, right side up
    curvature_right: Wheelsets  # 1/m, of the gap across the rail
    curvature_left: Wheelsets


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactTable:
    """Functions of y at equal steps: splines with continuous second derivatives, straight beyond the ends.

    From `start` (m) in steps of `step` (m). `rows` (intervals, functions, 4), in SI, are powers of (y - y_i)/step from 1 on, so that a wheelset takes one slice for all its functions.
    """

    start: Number  # m
    step: Number  # m
    rows: Number  # SI, of the functions in the order of FUNCTIONS

    @classmethod
    @guarded(geometry=Kind(ContactGeometry, "what railjax.contact_geometry returns"))
    def of(cls, geometry: ContactGeometry) -> "ContactTable":
        """The smooth functions of a `geometry` whose y are at equal steps."""
        y, smooth = np.asarray(geometry.smooth.y), geometry.smooth
        if not np.allclose(np.diff(y), y[1] - y[0], rtol=1e-6):
            raise InputError("the geometry's y must be at equal steps for a table")
        values = jnp.stack(
            [
                smooth.delta_r,
                *jnp.moveaxis(jnp.asarray(smooth.contact_angle), -1, 0),
                smooth.roll,
                *jnp.moveaxis(jnp.asarray(smooth.curvature), -1, 0),
            ],
            axis=-1,
        )
        step = y[1] - y[0]
        return cls(y[0], step, cubic_rows(jnp, values, step * (jnp.asarray(slopes_of(len(y), step)) @ values)))

    def at(self, y: Wheelsets) -> ContactAt:
        """The functions at displacements y (m), any shape."""
        within, beyond, (a, b, c, d) = self._row(y)
        slope = b + within * (2.0 * c + within * 3.0 * d)
        return ContactAt(*jnp.moveaxis(a + within * (b + within * (c + within * d)) + beyond * slope, -1, 0))

    def rates(self, y: Wheelsets) -> ContactAt:
        """Their derivatives by y (m): roll'(y) and so on."""
        within, _, (_, b, c, d) = self._row(y)
        return ContactAt(*jnp.moveaxis((b + within * (2.0 * c + within * 3.0 * d)) / self.step, -1, 0))

    def _row(self, y: Wheelsets) -> tuple[Array, Array, Array]:
        t = (y - self.start) / self.step
        # clipped at the table's ends only: at those of an interval the derivative of `clip` would be halved
        inside = jnp.clip(t, 0.0, float(self.rows.shape[0]))
        index = jnp.clip(jnp.floor(inside), 0, self.rows.shape[0] - 1)
        return (inside - index)[..., None], (t - inside)[..., None], jnp.moveaxis(self.rows[index.astype(int)], -1, 0)


@functools.cache
def slopes_of(count: int, step: float) -> Float[np.ndarray, "n n"]:
    """The matrix that makes of values at equal steps the slopes of their spline."""
    from scipy.interpolate import CubicSpline

    y = step * np.arange(count)
    return CubicSpline(y, np.eye(count))(y, 1)
