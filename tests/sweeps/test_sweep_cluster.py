"""Sweeps beyond one process: executors, a dask worker that is killed, several devices, two processes of jax.distributed."""

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest
import sweep_study
import xarray

import railjax

FOLDER = Path(__file__).parent
ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(FOLDER.parents[1]), str(FOLDER), os.environ.get("PYTHONPATH", "")]),
}


@pytest.fixture(scope="module")
def expected(coach):
    return sweep_study.run(coach)


def same(found, expected):
    assert sorted(found.variables) == sorted(expected.variables)
    for name in expected.variables:
        assert found[name].values.tobytes() == expected[name].values.tobytes(), name


def test_worker_processes_compute_the_same_bits(coach, expected, tmp_path):
    spawn = multiprocessing.get_context("spawn")  # a forked process would share JAX's threads
    with ProcessPoolExecutor(1, mp_context=spawn) as executor:
        same(sweep_study.run(coach, executor=executor, out=tmp_path / "s.zarr"), expected)


def test_threads_do_as_well_and_no_more_chunks_are_out_than_asked(coach, expected):
    out = []

    class Counting(ThreadPoolExecutor):
        def submit(self, *arguments):
            future = super().submit(*arguments)
            out.append(future)
            assert sum(not future.done() for future in out) <= 3
            return future

    with Counting(2) as executor:
        same(sweep_study.run(coach, executor=executor, in_flight=3), expected)
    assert len(out) == 10


def test_a_dask_worker_is_killed_in_mid_study(coach, expected):
    from dask.distributed import Client, LocalCluster

    killed = []
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        workers = client.run(os.getpid)

        def kill(at):
            if not killed:
                killed.extend(list(workers.values())[:1])
                os.kill(killed[0], signal.SIGKILL)

        found = sweep_study.run(coach, executor=client.get_executor(), in_flight=4, progress=kill)
    assert len(workers) == 2
    assert len(killed) == 1
    same(found, expected)


class Failing:
    """An executor whose every chunk fails a few times, as under a worker that dies."""

    def __init__(self, times, where="result"):
        self.times, self.where, self.tries = times, where, {}

    def submit(self, work, *arguments):
        number = arguments[3]["speed"][0]
        self.tries[number] = self.tries.get(number, 0) + 1
        future = Future()
        if self.tries[number] > self.times:
            future.set_result(work(*arguments))
        elif self.where == "submit":
            raise BrokenExecutor("gone")
        else:
            future.set_exception(RuntimeError("the worker died"))
        return future


def test_a_chunk_is_given_out_again_but_not_for_ever(coach, expected, caplog):
    same(sweep_study.run(coach, executor=Failing(2)), expected)
    assert len(caplog.records) == 20
    with pytest.raises(railjax.NumericalError, match=r"chunk \d failed 4 times .*RuntimeError: the worker died"):
        sweep_study.run(coach, executor=Failing(9))
    with pytest.raises(railjax.NumericalError, match="a worker of the executor died"):
        sweep_study.run(coach, executor=Failing(1, "submit"))


def test_errors_of_a_study_come_back_from_the_workers():
    def partly(speed):
        if np.any(speed > 55.0):
            raise ValueError("too fast")
        return speed

    def never(speed):
        raise railjax.InputError("no such thing") if speed[0] < 52.0 else KeyError("slip")

    speeds = np.arange(50.0, 60.0)
    with ThreadPoolExecutor(1) as executor:
        found = railjax.sweep(partly, {"speed": speeds}, chunk=5, executor=executor)
        np.testing.assert_array_equal(found["code"], np.where(speeds > 55.0, -1, 0))
        with pytest.raises(railjax.InputError, match="no such thing"):
            railjax.sweep(never, {"speed": [50.0]}, executor=executor)
        with pytest.raises(railjax.NumericalError, match="at every point tried of chunk 0: KeyError: 'slip'"):
            railjax.sweep(never, {"speed": [55.0]}, executor=executor)
        with pytest.raises(railjax.InputError, match="cannot be sent to workers"):
            railjax.sweep(lambda speed, lock=threading.Lock(): speed, {"speed": speeds}, executor=executor)  # noqa: B008


def on_devices():
    """Bits of two sweeps, printed for every process to be the same: forced runs, sharded by `jax.shard_map`, and single points."""
    one = railjax.each_point(lambda vehicle, speed: railjax.state_matrix(vehicle, speed)[2:, 0])
    vehicle = railjax.load_vehicle("single-wheelset")
    forced = railjax.ForcedRun(("rms:wheelset_y",), duration=0.2)
    for study, chunk in ((forced, 128), (one, 8)):
        over = {"speed": np.linspace(40.0, 80.0, 2 * chunk + 3)}
        options = {"track": railjax.SinusoidTrack(2e-3, 8.0)} if study is forced else {}
        found = railjax.sweep(study, over, vehicle=vehicle, chunk=chunk, **options)
        assert found.attrs["computed_on"].startswith(f"{jax.local_device_count()} cpu device(s)")
        assert np.all(found["code"] == 0)
        print(*[found[name].values.tobytes().hex() for name in found.data_vars])


FOUR = """
import jax, railjax, test_sweep_cluster
railjax.use_double_precision()
jax.config.update("jax_num_cpu_devices", 4)
test_sweep_cluster.on_devices()
"""


def test_the_number_of_devices_does_not_touch_the_numbers(capsys):
    four = subprocess.run([sys.executable, "-c", FOUR], capture_output=True, text=True, env=ENVIRONMENT, timeout=300)
    assert four.returncode == 0, four.stderr
    on_devices()
    assert capsys.readouterr().out == four.stdout
    assert len(four.stdout.splitlines()) == 2


def test_two_processes_share_a_sweep(expected, tmp_path):
    """The recipe for several hosts: jax.distributed.initialize, then the same call in every process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    store = tmp_path / "s.zarr"
    processes = [
        subprocess.Popen(
            [sys.executable, str(FOLDER / "sweep_study.py"), str(store), "0", address, str(k)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=ENVIRONMENT,
        )
        for k in range(2)
    ]
    for process in processes:
        out, error = process.communicate(timeout=300)
        assert process.returncode == 0, error
        lines = [line for line in out.splitlines() if "Gloo" not in line]
        # five of the ten chunks each; after the barrier every point is there
        assert lines == ["12", "24", "36", "48", "60", "codes 0"]
    same(xarray.open_zarr(store), expected)
