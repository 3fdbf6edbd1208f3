"""How XLA compiles the simulation on CPU: few, large kernels. Numbers do not depend on it, only speed.

XLA's CPU backend runs a loop's body as a sequence of small kernels, each dispatched at 25 to 40 ns, while the arithmetic of
a whole RK4 step of one vehicle takes 100 ns; and it evaluates an expression anew in every kernel that uses it. Two
attributes of a called function change that: `xla_cpu_small_call` compiles the call into one native function, and
`inlineable="false"` makes its outputs exist once. Measured: one 10 s run in 3.6 ms instead of 25 ms (JAX 0.10.1) or 6 ms
(JAX 0.12); `optimization_barrier`, the documented means to the second end, has no effect on CPU in JAX 0.10.1.

The attributes are XLA's own; a release that dropped them would only be slower (tests/base/test_kernels.py would say so).
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import get_opaque_trace_state

from .arguments import guarded
from .checks import traced

F = TypeVar("F", bound=Callable[..., Any])

# what JAX says where nothing is traced; this module may be imported while something is
with jax.core.eval_context():
    _OUTSIDE = get_opaque_trace_state()

#: options for batches on CPU: full-width vectors (1.2 times faster; single runs are slower with them)
WIDE = {"xla_cpu_prefer_vector_width": 512}

#: JAX 0.10 still has the emitter before the one that later releases have alone; it compiles in less time
OLDER = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}

#: options for large kernels on CPU that run for milliseconds: LLVM takes half the time and what it makes runs as fast (JAX 0.10.1: the
#: first steady curving in 2.4 s of processor time instead of 4.6, the check of dt of 1024 lanes in 0.7 s instead of 1.25)
QUICK = {"xla_backend_optimization_level": 1} | OLDER

#: options for large programs of many small parts that run a few dozen times, like a statistical linearisation or a derivative for `tune`:
#: compiled in 3.5 s of processor time instead of 8.7, run in 0.34 s instead of 0.25 (JAX 0.10.1; later releases have one emitter only)
HASTY = {"xla_backend_optimization_level": 0} | OLDER


def options(chosen: dict[str, int]) -> dict[str, int] | None:
    """Compiler options where they are known: on CPU."""
    return chosen if jax.default_backend() == "cpu" else None


#: eigenvalues with right eigenvectors: a function of its own, because within one of some thousand operations XLA (JAX 0.12) loses what
#: kind of call LAPACK's is and refuses it
eig = jax.jit(jnp.linalg.eig)


def fence(function: F) -> F:
    """The same function, its outputs materialised once instead of recomputed by each of their users (on CPU)."""
    called = jax.jit(function)

    @functools.wraps(function)
    def fenced(*arguments: Any) -> Any:
        if jax.default_backend() != "cpu":
            return function(*arguments)
        return set_xla_metadata(called(*arguments), inlineable="false")

    return fenced  # type: ignore[return-value]


def hasty(chosen: dict[str, Any] = HASTY, **of_jit: Any) -> Callable[[F], F]:
    """`jax.jit` with `HASTY`, or the options `chosen`; where the function is part of what is traced, that decides."""

    def decorated(function: F) -> F:
        within, alone = jax.jit(function, **of_jit), jax.jit(function, compiler_options=chosen, **of_jit)

        @functools.wraps(function)
        def compiled(*arguments: Any, **named: Any) -> Any:
            if traced((arguments, named)):
                return within(*arguments, **named)
            if get_opaque_trace_state() == _OUTSIDE:
                return alone(*arguments, **named)
            # of known numbers at once also where others are traced: JAX takes no options within another `jit`. While it traces, this does
            # single operations one by one, each compiled
            with jax.ensure_compile_time_eval():
                return alone(*arguments, **named)

        return compiled  # type: ignore[return-value]

    return decorated


def one_kernel(function: F) -> F:
    """The same function, compiled into one native function (on CPU). Works on the outermost function only: what derives
    from it, like its gradient, must be wrapped again.
    """
    called = jax.jit(function)

    @functools.wraps(function)
    def single(*arguments: Any) -> Any:
        if jax.default_backend() != "cpu":
            return function(*arguments)
        return set_xla_metadata(called(*arguments), inlineable="false", xla_cpu_small_call="true")

    return single  # type: ignore[return-value]


@guarded()
def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.jit` for functions that simulate, or differentiate a simulation: on CPU all of it becomes one kernel.

    >>> gradient = railjax.jit(jax.grad(objective))  # doctest: +SKIP

    For the outermost function, with arrays or pytrees as arguments. A reverse-mode gradient takes 6 times less time than with
    `jax.jit` on JAX 0.10.1, the same on 0.12; the numbers are the same. What XLA cannot put into one kernel (linear solvers,
    sorting, callbacks) is compiled as by `jax.jit`.
    """

    # XLA aborts the process on an argument of the kernel for which it finds no use, so that each has one
    def used(*arguments: Any) -> Any:
        return function(*arguments), [jnp.ravel(leaf)[:1] for leaf in jax.tree.leaves(arguments)]

    plain, single = jax.jit(function), jax.jit(one_kernel(used))
    refused = False

    @functools.wraps(function)
    def compiled(*arguments: Any) -> Any:
        nonlocal refused
        if refused or traced(arguments):
            return plain(*arguments)
        try:
            return single(*arguments)[0]
        except jax.errors.JaxRuntimeError:
            refused = True
            return plain(*arguments)

    return compiled
