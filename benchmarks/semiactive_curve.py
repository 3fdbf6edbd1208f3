"""The semi-active lateral damper in a curve: what becomes of balance logic, which sees a standing deflection there, and of its centred variant.

    python benchmarks/semiactive_curve.py

The coach through straight track, a transition and a long arc on a random track. On the straight and in the arc: mean and largest travel of the
secondary suspension, r.m.s. of the car body's acceleration about its mean, and P_CT of the transition (standing), for passive dampers, balance
logic and balance logic that takes off the mean travel of the last second or so (`centring`).
"""

import argparse

import numpy as np

import railjax

FRONT, TURN, ARC = 2000.0, 120.0, 3000.0  # m
LAWS = {
    "passive": railjax.PassiveDamper(),
    "balance logic": railjax.BalanceLogic(0.7),
    "centred over 0.5 s": railjax.BalanceLogic(0.7, centring=0.5),
    "centred over 1 s": railjax.BalanceLogic(0.7, centring=1.0),
    "centred over 2 s": railjax.BalanceLogic(0.7, centring=2.0),
    "centred over 4 s": railjax.BalanceLogic(0.7, centring=4.0),
}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--radius", type=float, default=1000.0, help="m")
    options.add_argument("--cant", type=float, default=0.1, help="m")
    options.add_argument("--speed", type=float, default=40.0, help="m/s")
    options.add_argument("--track", default="erri-high")
    given = options.parse_args()
    railjax.use_double_precision()
    coach = railjax.load_vehicle("coach")
    segments = [
        railjax.Segment.straight(FRONT),
        railjax.Segment.transition(TURN),
        railjax.Segment.arc(ARC, given.radius, given.cant),
    ]
    line = railjax.Layout(segments)
    deficiency = 1.5 / 9.81 * given.speed**2 / given.radius - given.cant
    steady = railjax.curving(coach, given.speed, radius=given.radius, cant=given.cant)
    print(f"R {given.radius:g} m at {3.6 * given.speed:.0f} km/h, cant deficiency {1e3 * deficiency:.0f} mm, {given.track}")
    print(f"steady curving without dampers: acceleration {float(steady.carbody_acceleration):.3f} m/s^2")
    print(
        f"{'':20s} {'straight: rms':>14s} {'largest travel':>15s} | {'arc: rms':>9s} {'mean travel':>12s} {'largest':>8s} | P_CT"
    )
    for name, law in LAWS.items():
        duration = np.floor((FRONT + TURN + ARC) / given.speed)
        run = railjax.simulate(
            coach, given.speed, track=railjax.RandomTrack(given.track, length=6e3), layout=line, damper=law, duration=float(duration),
            record=["floor_acceleration", "secondary_travel", "carbody_phi", "carbody_phi_rate"],
        )  # fmt: skip
        where = given.speed * np.asarray(run.time)
        travel, felt = 1e3 * np.asarray(run["secondary_travel"]), np.asarray(run["floor_acceleration"])[:, 0]
        straight, arc = (where > 300.0) & (where < FRONT - 50.0), where > FRONT + TURN + 10.0 * given.speed
        comfort = railjax.comfort(run, layout=line, mean=False)
        print(
            f"{name:20s} {np.std(felt[straight]):14.4f} {np.max(np.abs(travel[straight])):15.1f} | {np.std(felt[arc]):9.4f} "
            f"{np.mean(travel[arc]):12.2f} {np.max(np.abs(travel[arc])):8.1f} | {float(comfort.curves['standing'][0, 0]):.1f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
