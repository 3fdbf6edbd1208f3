"""A wheel profile changed by gradients: the highest nonlinear critical speed at a given steering ability, within half a millimetre.

    python benchmarks/wheel_profile.py --out wheel_profile.png

The calibrated coach on S1002 and 60E1 1:40 (a prediction: nothing is fitted to profiles). What changes are six control heights of the wheel, by
a spline; steering ability is Delta r at 5 mm, which decides how tight a curve a free wheelset can follow. Each step is a linear programme: the
tangents of critical speed and steering, by the envelope theorem at the contact points, within a reach that grows with success. A step counts
only if large disturbances die out 3 % below the speed that it claims: a search for folds can miss one. A wheel without conicity in the middle
wanders there for a minute, with waves of seconds, before it rests: what must shrink is the motion, however small it has become.
"""

import argparse
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import linprog

import railjax
from railjax.model.contact.profile_contact import contact_at

KMH = 3.6
#: m from the tread datum
AT = np.linspace(-30e-3, 20e-3, 6)
#: mm
MOST, REACH, LEAST = 0.5, 0.04, 3e-3
#: m, of each wheelset; s
DISTURBANCES, DURATION = ([3e-3] * 4, [6e-3] * 4, [8e-3, 8e-3, -8e-3, -8e-3], [2e-3, 4e-3, 6e-3, 8e-3]), 60.0
#: m; what has become so small has died out
DIED_OUT = 1e-5


def steering(vehicle: railjax.Vehicle) -> Any:
    """Delta r at 5 mm, m."""
    return 2.0 * contact_at(vehicle.profiles, jnp.full((1, 1), 5e-3)).radius[0, 0]


def chained(slopes: Any, rates: Any) -> np.ndarray:
    """Slopes by a vehicle's numbers and these by the control heights, together."""
    return sum(
        np.tensordot(rate, slope, np.ndim(slope))
        for rate, slope in zip(jax.tree.leaves(rates), jax.tree.leaves(slopes), strict=True)
    )


class Study:
    """Critical speed (km/h) and steering (mm) of a wheel changed by heights in mm, with their slopes."""

    def __init__(self) -> None:
        self.coach, self.wheel = railjax.load_vehicle("coach"), railjax.WheelProfile.load("S1002")

        def made(heights: jax.Array) -> railjax.Vehicle:
            return railjax.with_profiles(self.coach, self.wheel.changed(AT, heights))

        self.made = jax.jit(
            lambda heights: jax.vmap(lambda t: jax.jvp(made, (heights,), (t,)), out_axes=(None, 0))(jnp.eye(len(AT)))
        )

    def at(self, heights: np.ndarray) -> tuple[railjax.Vehicle, float, np.ndarray, float, np.ndarray]:
        vehicle, rates = self.made(jnp.asarray(1e-3 * heights, float))
        speed, slopes = jax.value_and_grad(railjax.nonlinear_critical_speed)(vehicle)
        able, along = jax.value_and_grad(steering)(vehicle)
        return vehicle, KMH * float(speed), 1e-3 * KMH * chained(slopes, rates), 1e3 * float(able), chained(along, rates)


def holds(vehicle: railjax.Vehicle, speed: float) -> bool:
    """Whether large disturbances die out 3 % below a critical speed (km/h)."""
    for disturbance in DISTURBANCES:
        run = railjax.simulate(
            vehicle,
            0.97 * speed / KMH,
            duration=DURATION,
            dt=5e-4,
            sample=1e-2,
            initial={"wheelset_y": np.array(disturbance)},
            record=("wheelset_y",),
        )
        _, middle, late = (np.ptp(third, axis=0).max() for third in np.array_split(np.asarray(run["wheelset_y"]), 3))
        if not run.ok or late > max(0.5 * middle, DIED_OUT):
            return False
    return True


def main() -> None:
    """Print each step, and draw the profiles' difference, the conicity and Delta r before and after."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="wheel_profile.png")
    parser.add_argument("--steps", type=int, default=12)
    options = parser.parse_args()
    railjax.use_double_precision()
    railjax.use_all_cores()
    study, heights, reach, began = Study(), np.zeros(len(AT)), REACH, time.perf_counter()
    first = now = study.at(heights)
    print(
        f"S1002: {now[1]:.2f} km/h, Delta r at 5 mm {now[3]:.3f} mm, large disturbances die out below it: {holds(now[0], now[1])}",
        flush=True,
    )
    for _ in range(options.steps):
        _, speed, slope, able, along = now
        low, high = np.maximum(-reach, -MOST - heights), np.minimum(reach, MOST - heights)
        found = linprog(-slope, A_ub=-along[None], b_ub=[able - first[3]], bounds=np.column_stack([low, high]))
        taken, why = False, "the programme has no answer"
        if found.status == 0:
            try:
                there = study.at(heights + found.x)
                why = f"{there[1]:.2f} km/h, Delta r {there[3]:.3f} mm"
                taken = there[1] > speed and there[3] > first[3] - 2e-3
                if taken and not holds(there[0], there[1]):
                    taken, why = False, why + ", but a large disturbance does not die out below it"
            except railjax.NumericalError as error:
                why = str(error)
        print(f"{time.perf_counter() - began:6.1f} s, reach {reach:.3f} mm: {why}{'' if taken else ': refused'}", flush=True)
        if taken:
            heights, now, reach = heights + found.x, there, 1.3 * reach
        else:
            reach *= 0.4
        if reach < LEAST:
            break
    print(f"heights at {(1e3 * AT).round(0).tolist()} mm: {heights.round(3).tolist()} mm; {first[1]:.1f} -> {now[1]:.1f} km/h")
    drawn(study, heights, options.out)


def drawn(study: Study, heights: np.ndarray, out: str) -> None:
    """The wheels and their contact, before and after."""
    picture = Figure(figsize=(12, 3.6), layout="constrained")
    axes = picture.subplots(1, 3)
    for name, by in (("S1002", np.zeros(len(AT))), ("changed", 1e-3 * heights)):
        wheel = study.wheel.changed(AT, by)
        found = railjax.contact_geometry(wheel, "60E1")
        at = np.linspace(0.5e-3, 7e-3, 40)
        axes[0].plot(1e3 * wheel.lateral, 1e3 * (wheel.height - study.wheel.height), label=name)
        axes[1].plot(1e3 * np.asarray(found.y), 1e3 * np.asarray(found.delta_r), label=name)
        axes[2].plot(1e3 * at, railjax.equivalent_conicity(found.y, found.delta_r, at), label=name)
    axes[0].set(xlabel="from the tread datum, mm", ylabel="change of the wheel's radius, mm", xlim=(-45, 45))
    axes[1].set(xlabel="lateral displacement, mm", ylabel="r_R - r_L, mm", xlim=(-7, 7), ylim=(-8, 8))
    axes[2].set(xlabel="amplitude, mm", ylabel="equivalent conicity", ylim=(0, 0.6))
    for ax in axes:
        ax.grid(alpha=0.3)
    axes[0].legend()
    picture.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
