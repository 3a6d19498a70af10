"""Whether this machine can take a trajectory, asked before any work."""

import jax.numpy as jnp

from vibrojax.amounts import size_text
from vibrojax.errors import Place
from vibrojax.scenes import _rock
from vibrojax.simulation._record import MOST_STEPS
from vibrojax.stepping.adaptive import MOST_STEPS as MOST_ADAPTIVE
from vibrojax.sweep import memory

CALMEST = {"slip": 1.0, "touching": 0.0, "rock": _rock.REST, "pushing": 0.0}
"""Of each discrete state the one in which steps are longest."""

COPIES = 3
"""Of every step's polynomials that are held at once: in batches, put together, and those that are read."""


def check_size(place: Place, machine, p, duration: float, accuracy, method: str, samples: int) -> int:
    """The most steps that there is room for; raises `InputError` where the motion takes more even without events.

    **Arguments:** `p`: the scene's constants, each of shape (1,); `accuracy`: what the steps follow from; `method`: by
    its name; `samples`: how many are asked for.
    """
    most, each = _room(machine, method, samples)
    natural = _rate(machine, p, method) / accuracy.stride
    # How a solver of diffrax steps is its own affair, but it must follow the main spring.
    given = 0.0 if method == "diffrax" else 1 / accuracy.step
    steps = duration * max(natural, given)
    if steps <= most:
        return most
    needs = f"{steps:.3g} steps" + (f" and {size_text(COPIES * steps * each)} of memory" if each else "")
    there = memory() if each else None
    allowed = f"{most:.3g} steps" + (f" and {size_text(there)} of memory" if there else "")
    advice = "give a shorter duration" + (", a longer step or a greater error" if given > natural else "")
    raise place.at("duration").error(f"{duration:g} s need some {needs}; there is room for {allowed}: {advice}")


def _rate(machine, p, method: str) -> float:
    """How fast the motion changes at least [1/s]."""
    if method == "diffrax":
        return float(jnp.sqrt(p["k1"] / p["m1"])[0])
    return float(machine.rate(p, tuple(jnp.full(1, CALMEST[name]) for name in machine.modes))[0])


def _room(machine, method: str, samples: int) -> tuple[int, float]:
    """How many steps there is room for, and the bytes that each takes; those of diffrax are not kept."""
    if method == "diffrax":
        return MOST_ADAPTIVE, 0.0
    orders = 11 if method == "located" else 4
    numbers = 3 + len(machine.states) * (orders + 1) + len(machine.modes)
    flags = len(machine.surfaces_named) + 2 * len(machine.markers_named)
    each = 8.0 * numbers + flags
    there = memory()
    if there is None:
        return MOST_STEPS, each
    return max(min(MOST_STEPS, int((there - 2 * samples * each) / (COPIES * each))), 0), each
