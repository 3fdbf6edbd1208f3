"""What is compiled, kept on disk: found by later processes, whole or by XLA's part alone, and never the wrong program."""

import os
import subprocess
import sys
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import numpy as np
import pytest

import railjax
from railjax.base import programs
from railjax.base.packing import Form
from railjax.base.programs import forget_compiled
from railjax.model.motion import state_matrices

RUN = """60.0, damper=railjax.BalanceLogic(0.5), initial={"wheelset_y": 9.5e-3}, duration=0.5, record=(), reduce=["rms:wheelset_y"]"""


@pytest.mark.parametrize("whole", [False, True])
def test_a_later_process_finds_what_was_compiled(tmp_path, coach, whole):
    """And says nothing of it, though JAX 0.10 takes wishes of its compiler for features that the processor lacks. XLA's own settings give
    the numbers that those of tests/conftest.py do."""
    code = f"""
import sys, jax, railjax
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event) if event.endswith("/cache_hits") else None)
print(railjax.keep_compiled({str(tmp_path / "kept")!r}, whole={whole}))
railjax.use_double_precision()
coach = railjax.load_vehicle("coach")
print(railjax.linear_critical_speed(coach))
print(float(railjax.simulate(coach, {RUN})["rms:wheelset_y"][0]))
print(len(hits))
"""
    apart = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "TF_CPP_MIN_LOG_LEVEL")
    environment = {key: value for key, value in os.environ.items() if key not in apart}
    runs = [subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True) for _ in range(2)]
    assert [(run.returncode, run.stderr) for run in runs] == [(0, ""), (0, "")]
    first, second = (run.stdout.split() for run in runs)
    assert first[0] == str(tmp_path / "kept")
    assert first[:3] == second[:3]
    # what is kept whole JAX does not look for, only for single operations
    assert first[3] == "0"
    assert 0 < int(second[3]) <= 3 if whole else int(second[3]) > 3
    assert (len(list((tmp_path / "kept").glob("*.program"))) >= 3) == whole
    run = eval(f"railjax.simulate(coach, {RUN})", {"railjax": railjax, "coach": coach})
    here = float(railjax.linear_critical_speed(coach)), float(run["rms:wheelset_y"][0])
    np.testing.assert_allclose([float(value) for value in first[1:3]], here, rtol=1e-9)


def test_only_the_false_alarm_is_kept_from_standard_error(capfd):
    alarm = "E1125 15:59:58.341676 10200 cpu_aot_loader.cc:195] Loading XLA:CPU AOT result. Target machine feature {} is not  supported on"

    def load(loud):
        for feature in ("+prefer-no-gather", "+avx512f", "+prefer-no-scatter"):
            os.write(2, f"{alarm.format(feature)} the host machine.\n".encode())
        if loud:
            raise OSError("torn")
        return 1

    quiet = programs._without_false_alarm(load)
    assert quiet(False) == 1
    with pytest.raises(OSError, match="torn"):
        quiet(True)
    os.write(2, b"after")
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 3
    assert all("+avx512f" in line for line in lines[:2])
    assert lines[2] == "after"


def test_what_was_used_longest_ago_is_deleted_where_much_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "KEPT", 1000)
    programs._forget(tmp_path / "none")
    for k in range(10):
        (tmp_path / str(k)).write_bytes(bytes(99))
        os.utime(tmp_path / str(k), (1e9 + k, 1e9))
    programs._forget(tmp_path)
    assert len(list(tmp_path.iterdir())) == 10
    (tmp_path / "10").write_bytes(bytes(99))
    programs._forget(tmp_path)
    assert sorted(int(file.name) for file in tmp_path.iterdir()) == [6, 7, 8, 9, 10]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Own:
    """A law of a user's, whose source is not railjax's."""

    damping: Any = 3e4  # N s/m

    internal_states: ClassVar[int] = 0

    def force(self, vehicle, travel, velocity, internal):
        return self.damping * velocity, internal


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", tmp_path)
    yield tmp_path
    forget_compiled()


def test_a_whole_program_is_neither_traced_nor_compiled_again(folder, coach, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("traced")

    first = state_matrices(coach, 60.0, railjax.PassiveDamper())
    (file,) = folder.iterdir()
    forget_compiled()
    with monkeypatch.context() as patched:
        patched.setattr(jax, "jit", refuse)
        np.testing.assert_array_equal(state_matrices(coach, 60.0, railjax.PassiveDamper()), first)
        stiffer = state_matrices(railjax.replace(coach, primary__stiffness_y=5e6), 50.0, railjax.PassiveDamper())
        assert not np.array_equal(stiffer, first)
        with pytest.raises(AssertionError, match="traced"):
            state_matrices(coach, 60.0, railjax.Skyhook(0.5))
    with jax.disable_jit():
        np.testing.assert_allclose(state_matrices(coach, 60.0, railjax.PassiveDamper()), first, rtol=1e-9, atol=1e-9)
    # torn on its way to the disk: made anew; and not kept where JAX's own cache had it, as it could not be written whole
    forget_compiled()
    file.write_bytes(file.read_bytes()[:1000])
    for _ in range(2):
        np.testing.assert_array_equal(state_matrices(coach, 60.0, railjax.PassiveDamper()), first)
        forget_compiled()


def test_what_is_not_railjax_s_own_is_not_kept_whole(folder, coach):
    found = state_matrices(coach, 60.0, Own())
    assert not list(folder.iterdir())
    np.testing.assert_allclose(found, state_matrices(coach, 60.0, railjax.PassiveDamper(1.5e4)), rtol=1e-12, atol=1e-9)


def test_programs_are_known_by_all_that_they_are_made_of(coach, monkeypatch):
    """Classes with the same fields, switches, shapes, source and settings; nothing is told by halves."""

    def form(*trees):
        return programs._told(Form.of(trees))

    told = [
        form(coach, law)
        for law in (
            railjax.PassiveDamper(),
            railjax.Skyhook(0.5),
            railjax.BalanceLogic(0.5),
            railjax.ADD(),
            railjax.Controller(railjax.Skyhook(0.5)),
            railjax.Controller(railjax.Skyhook(0.5), sensors=railjax.Sensors.typical(delay=3)),
        )
    ]
    told += [form(railjax.replace(coach, contact__law=law)) for law in ("smooth", "sharp", "linear")]
    told += [form(railjax.replace(coach, contact__conicity=value)) for value in (np.ones(2), np.ones(3))]
    assert len(set(told)) == len(told)
    assert form(coach) == form(railjax.replace(coach, primary__stiffness_y=5e6))
    for thing in (np.ones(2), object(), lambda: 1, Own(), Own, {"a": {1, 2}}, jax.tree.structure(Own())):
        with pytest.raises(programs._Untold):
            programs._told((1, thing))
    here = programs._surroundings()
    with monkeypatch.context() as changed:
        changed.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
        assert programs._surroundings() != here
    with jax.debug_nans(True):
        assert programs._surroundings() != here
    with monkeypatch.context() as changed:
        changed.setattr(programs, "digest_of_source", lambda *_: "another")
        changed.setattr(programs, "_machine", programs._machine.__wrapped__)
        assert programs._surroundings() != here
