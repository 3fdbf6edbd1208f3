"""Steady curving written by hand, in NumPy for SciPy: an independent solution of what `railjax.curving` finds."""

import numpy as np
from scipy.optimize import root

G, BASE = 9.81, 1.5


def equations(vehicle, speed, radius, cant):
    """Forces and moments (kN, kN m) on a vehicle of two bogies with two axles, body by body and spring by spring, of its coordinates and a
    share of the load."""
    p, s, g, c, w = vehicle.primary, vehicle.secondary, vehicle.geometry, vehicle.contact, vehicle.wheelset
    l, a, e, dc, do = g.half_pivot_distance, g.half_wheelbase, g.half_gauge, g.half_secondary, g.half_primary

    def forces(q, load):
        kappa, lateral = load / radius, speed**2 * load / radius - G * load * cant / BASE
        yc, pc, fc, yb, pb, fb = q[0], q[1], q[2], q[3:5], q[5:7], q[7:9]
        y, psi = q[9:13].reshape(2, 2), q[13:].reshape(2, 2)
        body, frame, wheels = np.zeros(3), np.zeros((2, 3)), np.zeros((2, 2, 2))
        body[0] = -vehicle.carbody.mass * lateral
        for j, x in enumerate((l, -l)):
            frame[j, 0] -= vehicle.bogie.mass * lateral
            # the car body seen from the bogie's place on the circle
            across = yc + g.carbody_height * fc + x * pc - kappa * x**2 / 2 - (yb[j] - g.bogie_to_secondary * fb[j])
            f = 2 * s.stiffness_y * across
            body += [-f, -f * x, -f * g.carbody_height]
            frame[j] += [f, 0.0, -f * g.bogie_to_secondary]
            turn = 2 * s.stiffness_x * dc**2 * (pc - kappa * x - pb[j])
            body[1] -= turn
            frame[j, 1] += turn
            roll = (2 * s.stiffness_z * dc**2 + s.anti_roll_stiffness) * (fc - fb[j])
            body[2] -= roll
            frame[j, 2] += roll - 4 * p.stiffness_z * do**2 * fb[j]
            for i, z in enumerate((a, -a)):
                f = 2 * p.stiffness_y * (yb[j] + z * pb[j] - kappa * z**2 / 2 + g.bogie_to_primary * fb[j] - y[j, i])
                turn = 2 * p.stiffness_x * do**2 * (pb[j] - kappa * z - psi[j, i])
                frame[j] += [-f, -f * z - turn, -f * g.bogie_to_primary]
                xi_x, xi_y = e * kappa + c.conicity * y[j, i] / w.wheel_radius, -psi[j, i]
                tx, ty = c.creep_longitudinal * xi_x, c.creep_lateral * xi_y
                u = np.hypot(tx, ty) / (c.friction * c.wheel_load)
                share = 1.0 if c.law == "linear" else 1 - u / 3 + u**2 / 27 if u < 3 else 1 / u
                flange = c.flange_stiffness * np.sign(y[j, i]) * max(abs(y[j, i]) - c.flange_clearance, 0.0)
                flange = 0.0 if c.law == "linear" else flange
                spin = share * c.creep_lateral_spin * kappa
                wheels[j, i] = (
                    f - w.mass * lateral - 2 * share * ty - 2 * spin - flange,
                    turn - 2 * e * share * tx + 2 * share * c.creep_lateral_spin * xi_y - 2 * share * c.creep_spin * kappa,
                )
        # newtons and metres; one unknown a body and direction, in the order of q
        parts = [body, frame[:, 0], frame[:, 1], frame[:, 2], wheels[..., 0].ravel(), wheels[..., 1].ravel()]
        return np.concatenate(parts) / 1e3

    return forces


def independent(vehicle, speed, radius, cant):
    """Equilibrium; the load grows, SciPy's hybrid method."""
    forces = equations(vehicle, speed, radius, cant)
    q = np.zeros(17)
    for load in np.linspace(0.05, 1.0, 20):
        found = root(lambda q, load=load: forces(q * 1e-3, load), q * 1e3, method="hybr", tol=1e-13, options={"maxfev": 20000})
        q = found.x * 1e-3
    assert np.max(np.abs(forces(q, 1.0))) < 1e-6  # mN
    return q
