"""Does a compiled program give one answer, whatever else the process does?

    python benchmarks/one_answer.py [--minutes 3] [--only NAME ...]      # as the process is: all cores, one device each
    python benchmarks/one_answer.py --all [--minutes 3]                  # every configuration below, each in a process of its own

A dozen programs of railjax, and three of plain JAX that others have found to give two answers (JAX issue 39741, TensorFlow
issue 126812), are called over and over in random order from several threads, several calls in flight at once, each program for
about the same time, while other programs are compiled and thrown away, and every `--forget` seconds everything compiled is
forgotten and made anew. All bits of every result are compared with those of the first call. Prints the number of calls and what
differed, by how much; exit status 1 if anything did. Of three minutes on two idle cores the quickest programs get some ten
thousand calls, the slowest some tens.

`--all` does this with two devices and one, with and without `xla_cpu_small_call`, with an intra-op pool of 1, 2 and 8 threads,
without Eigen's threads, and without YNNPACK's reductions where the release of JAX has them.

What a difference may come from: rounding cannot grow in these programs (a start off by an ulp moves the end of the skyhook run by
4e-16), so anything above 1e-12 is a lost or stale number, not another order of a sum; and a NumPy array handed to a compiled
function and changed before the result is read gives another answer by JAX's own rules (it is not copied, JAX issue 37830).
"""

import argparse
import functools
import os
import random
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

#: name -> environment and options of a configuration
CONFIGURATIONS: dict[str, tuple[dict[str, str], list[str]]] = {
    "as it is": ({}, []),
    "one device": ({}, ["--devices", "1"]),
    "no single kernels": ({}, ["--many-kernels"]),
    "pool of 1": ({"NPROC": "1"}, []),
    "pool of 8": ({"NPROC": "8"}, []),
    "no Eigen threads": ({"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}, []),
    "no YNNPACK reductions": ({"XLA_FLAGS": "--xla_cpu_experimental_ynn_fusion_type=-reduce"}, []),
}

Call = Callable[[], Any]


def programs() -> dict[str, Call]:
    """Name -> a call that returns arrays, dispatched and not waited for where JAX does so."""
    import dataclasses

    import jax
    import jax.numpy as jnp
    import numpy as np

    import railjax

    sys.path.append(str(ROOT / "tests"))
    import laws  # the runs of tests/dampers/test_damper_numerics.py, one of which once was off by 2e-7

    from railjax.model.parameters import without_labels
    from railjax.simulation.simulate import initial_state

    coach = railjax.load_vehicle("coach")
    linear = without_labels(railjax.replace(coach, contact__law="linear"))
    smooth = railjax.replace(coach, contact__law="smooth")
    track, rough = railjax.SinusoidTrack(4e-3, 20.0), railjax.RandomTrack("erri-high", seed=1, length=1000.0)
    speeds, stiffness = jnp.linspace(45.0, 75.0, 70), jnp.linspace(2e6, 5e6, 24)
    start = {"wheelset_y": [6e-3, 5e-3, -4e-3, 3e-3], "bogie_psi": [1e-3, -1e-3], "carbody_y": 5e-3}
    noise = np.random.default_rng(0).normal(size=(4000, 2))

    def ride(vehicle: Any, speed: Any, damper: Any = railjax.PassiveDamper(), on: Any = track) -> Any:  # noqa: B008
        kept = {"record": ["wheelset_y"], "reduce": ["rms:carbody_acceleration", "peak:guiding_force"]}
        run = railjax.simulate(vehicle, speed, track=on, damper=damper, duration=0.3, **kept)
        return run.channels, run.final

    def rms(damping: Any) -> Any:
        vehicle = railjax.replace(smooth, secondary__damping_y=damping, primary__stiffness_x=damping * 150.0)
        run = railjax.simulate(vehicle, 50.0, track=track, duration=0.2, record=[], reduce=["rms:carbody_acceleration"])
        return run["rms:carbody_acceleration"]

    def twin(name: str) -> Call:
        damper = dataclasses.replace(laws.ALL[name], law="smooth", velocity_width=0.1, signal_width=1.0)
        x = initial_state(linear, damper, start)
        return lambda: [laws.final(linear, damper, x, 0.3, steps) for steps in (150, 212, 300, 424, 1500)]

    reverse, weighted = railjax.jit(jax.grad(rms)), jax.jit(lambda a: railjax.weighted_rms(a, 200.0, "Wd", 2.0))
    alone, rough_ride = (jax.jit(functools.partial(ride, coach, on=on)) for on in (track, rough))
    respond = jax.jit(lambda speed: railjax.frequency_response(coach, speed).transfer)
    linearise = jax.jit(lambda speed: railjax.statistical_linearisation(coach, speed).gains)
    crossings = jax.jit(lambda stiffness: railjax.linear_critical(railjax.replace(coach, primary__stiffness_x=stiffness)))
    # as TensorFlow issue 126812: each is wrong beyond rounding where tasks overwrite each other's partial sums
    broadcast = jax.jit(lambda a: jnp.sum(jnp.broadcast_to(a, (2, 1024, 1024))))
    column, matrix = jnp.ones((1024, 1)), jnp.asarray(np.random.default_rng(1).normal(size=(400, 400)))
    both = jax.jit(lambda a: (jnp.sum(a, axis=0), jnp.sum(a, axis=1), jnp.sum(a * a)))
    product = jax.jit(lambda a: a @ a)
    return {
        "one run": lambda: alone(50.0),
        "one run, random track": lambda: rough_ride(50.0),
        "batch": lambda: ride(coach, speeds),
        "batch, balance logic": lambda: ride(coach, speeds, railjax.BalanceLogic(0.7)),
        "skyhook, continuous": twin("skyhook, continuous"),
        "balance": twin("balance"),
        "reverse gradient": lambda: reverse(25e3),
        "nonlinear critical speed": lambda: railjax.nonlinear_critical_speed(coach),
        "linear critical speeds": lambda: crossings(stiffness),
        "frequency response": lambda: respond(60.0),
        "statistical linearisation": lambda: linearise(50.0),
        "weighted r.m.s.": lambda: weighted(noise),
        "plain: broadcast and sum": lambda: broadcast(column),
        "plain: sums": lambda: both(matrix),
        "plain: product": lambda: product(matrix),
    }


def bits(result: Any) -> list[bytes]:
    import jax
    import numpy as np

    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(result)]


def distance(result: Any, first: list[bytes]) -> str:
    """How far a result is from the first call's, for the report."""
    import jax
    import numpy as np

    def off(leaf: Any, before: bytes) -> tuple[float, float]:
        now, then = np.atleast_1d(np.asarray(leaf)), np.frombuffer(before, np.asarray(leaf).dtype).reshape(np.shape(leaf))
        return float(np.max(np.abs(now - then))), float(np.max(np.abs(then)))

    pairs = [off(leaf, before) for leaf, before in zip(jax.tree.leaves(result), first, strict=True)]
    return "; ".join(f"leaf {k}: {most:.2g} of {size:.2g}" for k, (most, size) in enumerate(pairs) if most != 0.0)


class Stress:
    """The programs, the first answer of each, and what came later."""

    def __init__(self, only: list[str] | None, strangers: int, forget: float) -> None:
        everything = programs()
        self.calls = {name: call for name, call in everything.items() if not only or any(part in name for part in only)}
        self.first = {name: bits(call()) for name, call in self.calls.items()}
        self.shares = [1.0 / self.seconds(name) for name in self.calls]
        self.counts: Counter[str] = Counter()
        self.forget = forget
        self.different: list[str] = []
        self.strangers = [self.stranger(k) for k in range(strangers)]

    def seconds(self, name: str) -> float:
        """Of a call once it is compiled."""
        start = time.perf_counter()
        bits(self.calls[name]())
        return time.perf_counter() - start

    @staticmethod
    def stranger(number: int) -> Any:
        """Another program, compiled and called."""
        import jax
        import jax.numpy as jnp

        other = jax.jit(lambda x: jnp.sin(x * (1.0 + number)) @ jnp.cos(x + number))
        other(jnp.linspace(0.0, 1.0, 40 + number % 300)).block_until_ready()
        return other

    def work(self, seed: int, until: float, in_flight: int) -> None:
        """One thread's calls."""
        import gc

        import jax

        rng = random.Random(seed)
        forget, meet = time.monotonic() + self.forget, time.monotonic()
        while (now := time.monotonic()) < until:
            names = rng.choices(list(self.calls), self.shares, k=in_flight)
            names += [names[0]] * rng.randrange(3)  # one program several times at once
            flight = [(name, self.calls[name]()) for name in names]
            for name, result in flight:
                self.counts[name] += 1
                if bits(result) != self.first[name]:
                    self.different.append(f"{name}, call {self.counts[name]}: {distance(result, self.first[name])}")
                    print("different:", self.different[-1], flush=True)
            if now > meet:
                meet = now + 5.0
                self.stranger(rng.randrange(10**6))
                gc.collect()
            if seed == 0 and now > forget:
                forget = now + self.forget
                jax.clear_caches()


def configure(options: argparse.Namespace) -> None:
    import jax

    import railjax

    cache = ROOT / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    railjax.use_double_precision()
    if options.devices is None:
        railjax.use_all_cores()
    else:
        jax.config.update("jax_num_cpu_devices", options.devices)
    if options.many_kernels:
        import railjax.base.compilation

        railjax.base.compilation.set_xla_metadata = lambda value, **_: value


def every_configuration(minutes: float, rest: list[str]) -> int:
    worst = 0
    for name, (environment, options) in CONFIGURATIONS.items():
        command = [sys.executable, __file__, "--minutes", f"{minutes:g}", *options, *rest]
        print(f"== {name}", flush=True)
        status = subprocess.run(command, env=os.environ | environment).returncode
        if status < 0:  # XLA aborts on a flag that it does not know
            print("not to be had with this release of JAX", flush=True)
        worst = max(worst, status)
    return worst


def main() -> int:
    parser = argparse.ArgumentParser(description="Calls compiled programs over and over and compares all bits.")
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="programs by name, or a part of it")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--in-flight", type=int, default=4, help="calls of a thread before it reads the first result")
    parser.add_argument("--strangers", type=int, default=300, help="other programs compiled before, and kept")
    parser.add_argument("--forget", type=float, default=300.0, help="seconds after which everything is compiled anew")
    parser.add_argument("--devices", type=int, help="CPU devices; default one per core")
    parser.add_argument("--many-kernels", action="store_true", help="without xla_cpu_small_call and fences")
    parser.add_argument("--all", action="store_true", help="every configuration, each in a process of its own")
    options = parser.parse_args()
    if options.all:
        rest = ["--strangers", str(options.strangers)] + (["--only", *options.only] if options.only else [])
        return every_configuration(options.minutes, rest)
    configure(options)
    import jax

    stress = Stress(options.only, options.strangers, options.forget)
    until = time.monotonic() + 60.0 * options.minutes
    work = functools.partial(stress.work, until=until, in_flight=options.in_flight)
    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(options.threads)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(
        f"jax {jax.__version__}, {jax.device_count()} device(s): {stress.counts.total()} calls, {len(stress.different)} different"
    )
    print("  " + ", ".join(f"{name} {count}" for name, count in stress.counts.items()))
    return int(bool(stress.different))


if __name__ == "__main__":
    sys.exit(main())
