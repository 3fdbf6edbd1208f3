"""A long sweep: does its memory stay flat, and does it survive being killed?

    python benchmarks/sweep_endurance.py [--points 100000] [--kills 3] [--seed 0]

runs 100 000 variants of the coach with balance logic for 2 s each (1 ms steps, Latin hypercube over speed, guidance stiffness
and alpha) in a process of its own and reads its resident memory after every chunk; then the same again into another store, the process killed
(SIGKILL) at random moments and started anew; and compares the two stores bit by bit. Exit status 1 where a bar is missed.
"""

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DURATION = 2.0
FLAT = 0.1  # share by which the resident memory may differ from that after the first chunk


def compute(points: int, out: str) -> None:
    """The sweep; after every chunk a line with points done and resident memory on standard output."""
    import railjax
    from railjax.base.progress import Progress

    railjax.use_double_precision()
    railjax.use_all_cores()

    def report(progress: Progress) -> None:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        print(json.dumps([progress.done, pages * os.sysconf("SC_PAGE_SIZE") / 2**20, progress.rate]), flush=True)

    railjax.sweep(
        railjax.ForcedRun(reduce=("rms:carbody_acceleration", "peak:guiding_force"), duration=DURATION),
        over={"speed": (40.0, 80.0), "primary.stiffness_x": (2e6, 5e6), "damper.alpha": (0.2, 1.0)},
        design="latin-hypercube",
        samples=points,
        vehicle=railjax.load_vehicle("coach"),
        track=railjax.SinusoidTrack(5e-3, 20.0),
        damper=railjax.BalanceLogic(),
        out=out,
        progress=report,
    )


def start(points: int, out: Path) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, __file__, "--points", str(points), "--compute", str(out)], stdout=subprocess.PIPE, text=True
    )


def read(process: subprocess.Popen, kill_after: int | None = None, pause: float = 0.0) -> list[list[float]]:
    """The lines of a run; if so wanted it is killed some seconds after it has written so many chunks."""
    found = []
    for line in process.stdout:
        found.append(json.loads(line))
        if len(found) == kill_after:
            time.sleep(pause)
            process.send_signal(signal.SIGKILL)
            break
    code = process.wait()
    process.stdout.close()
    if code != (0 if kill_after is None else -signal.SIGKILL):
        sys.exit(f"the sweep failed with exit status {code}")
    return found


def same(one: Path, other: Path) -> bool:
    """Whether two stores hold the same bits."""
    import xarray

    a, b = (xarray.open_zarr(str(path), chunks=None) for path in (one, other))
    return all(a[name].values.tobytes() == b[name].values.tobytes() for name in {*a.variables, *b.variables})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--compute", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.compute:
        compute(options.points, options.compute)
        return
    random.seed(options.seed)
    with tempfile.TemporaryDirectory() as folder:
        calm, killed = Path(folder) / "calm.zarr", Path(folder) / "killed.zarr"
        begun, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        lines = read(start(options.points, calm))
        seconds = time.monotonic() - begun
        memory = [megabytes for _, megabytes, _ in lines]
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
        steps = options.points * DURATION * 1e3
        print(
            f"{options.points} points of {DURATION:g} s, {len(lines)} chunks: {seconds:.0f} s, {cpu:.0f} s of processor time;",
            end=" ",
        )
        print(f"{steps / seconds / 1e6:.2f} million steps/s, {steps / cpu / 1e6:.2f} per second of processor time")
        drift = max(abs(m / memory[0] - 1.0) for m in memory)
        print(f"resident memory: {memory[0]:.0f} MB after the first chunk, {memory[-1]:.0f} MB after the last,", end=" ")
        print(f"{min(memory):.0f} to {max(memory):.0f} MB between; at most {drift:.1%} from the first")
        before = 0
        for kill in range(options.kills):
            chunks = random.randint(1, max(1, len(lines) // (options.kills + 1)))
            # anywhere in the chunk that follows, or while it is written
            found = read(start(options.points, killed), chunks, random.uniform(0.0, seconds / len(lines)))
            done = int(found[-1][0])
            print(f"kill {kill + 1}: from {before} points on, SIGKILL after {done} of them were written")
            before = done
        read(start(options.points, killed))
        equal = same(calm, killed)
        print(f"results of the killed and resumed sweep: {'bit-identical' if equal else 'DIFFERENT'}")
    sys.exit(0 if equal and drift <= FLAT else 1)


if __name__ == "__main__":
    main()
