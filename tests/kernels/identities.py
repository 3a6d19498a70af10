"""Objects and their digests, for processes in which the functions of the package are as users have them."""

import math
import os
from functools import partial

import numpy as np
import pandas as pd

import vibrojax as vj
from vibrojax.compile import native
from vibrojax.compile.identity import digest


def oscillator(restitution=0.8, stiffness=1.0, table=(1.0, 2.0)):
    values = np.array(table)

    def field(t, y, p):
        return {"x": y["v"], "v": p["a"] * vj.elementary.cos(p["omega"] * t) - stiffness * y["x"] + 0.0 * values[0]}

    stop = vj.Impact("stop", gap=lambda t, y, p: p["d"] - y["x"], velocity="v", restitution=restitution)
    return vj.System(
        "oscillator",
        states={"x": "m", "v": "m s-1"},
        parameters={"a": 0.5, "omega": 2.0, "d": 0.5},
        field=field,
        period=lambda p: 2 * math.pi / p["omega"],
        events=[stop],
    )


FACTOR = 2.0


def scaled(x):
    return FACTOR * x


def of_equal():
    """Return digests of pairs of equal objects."""
    drill = vj.SCENES["vibro-impact"]
    return [[digest(oscillator()), digest(oscillator())], [digest(drill()), digest(drill())]]


def of_different():
    """Return digests of objects that give different traces."""
    global FACTOR
    drill, laws, before = vj.SCENES["vibro-impact"], vj.FRICTION_LAWS, digest(scaled)
    coulomb = laws["coulomb"]
    own = [vj.FrictionLaw("own", "here", coulomb.parameters, mu) for mu in (lambda u, p: 0.3, lambda u, p: 0.4)]
    FACTOR = 3.0
    return [
        *(digest(oscillator(*values)) for values in ((), (0.7,), (0.8, 1.5), (0.8, 1.0, (1.0, 3.0)))),
        *(digest(drill(friction=law)) for law in (laws["stribeck"], coulomb, *own)),
        *(digest(function) for function in (lambda x: x + 1, lambda x: x + 2, lambda x: x + 2.0, lambda x: x - 1)),
        *(digest(partial(scaled, x)) for x in (1, 1.0, True, -0.0, 0.0, np.float32(1), np.float64(1))),
        before,
        digest(scaled),
        *(digest(vj.Located(order=order)) for order in (10, 12)),
    ]


def of_patched():
    """Return the digest of a scene before and after a method of its class is replaced."""
    drill = vj.SCENES["vibro-impact"]
    before = digest(drill())
    drill.rate = lambda self, c, mode: 1.0
    return [before, digest(drill())]


def traced():
    """Trace all kernels of some sweeps; return their number, and that of those with the trace of a process before."""
    known, read, enter = {}, native.Kernel.found, native.Kernel.enter

    def found(name):
        kernel = read(name)
        known[name] = None if kernel is None else kernel.key

    def entered(kernel, name):
        assert known[name] in (None, kernel.key), "one digest, two traces"
        enter(kernel, name)

    found.__module__ = entered.__module__ = native.__name__  # otherwise, the package counts as changed
    native.Kernel.found, native.Kernel.enter = found, entered
    native.CODE_LEVEL = 0  # the traces are the same, and compile faster
    run = {"settle": 9.0, "observe": 9.0}
    vj.run_sweep({"scene": oscillator(), "grid": {"omega": [1.8, 2.0]}, "run": run}, progress=False)
    return [len(known), sum(key is not None for key in known.values())]


def by_import(x):
    import statistics

    return statistics.mean([x])


class Clock:
    def __call__(self, x):
        return x * np.random.default_rng().random()


UNCERTAIN = {
    "import": by_import,
    "random": Clock(),
    "file": lambda x: np.loadtxt("table") * x,
    "eval": lambda x: eval("x"),
    "getattr": lambda x: getattr(math, "sin")(x),  # noqa: B009
    "environment": lambda x: os.environ["FACTOR"] * x,
    "other library": lambda x: pd.Series(x),
    "set": {object()},
    "iterator": iter([1]),
}


def of_uncertain():
    """Return digests of functions that use what does not decide a trace, by name."""
    return {name: digest(lambda x, code=code: code(x)) for name, code in UNCERTAIN.items()}
