"""One lane of a scene with rock, step by step, for the tests in this folder."""

import jax
import jax.numpy as jnp
import numpy as np
from flat import Flat
from numpy.polynomial import polynomial

from vibrojax.lanes.record import record, sample
from vibrojax.scenes.penetration import Penetration
from vibrojax.stepping import Accuracy, Located

FINE = Accuracy(tolerance=1e-12, stride=1.0, step=np.inf)
ELASTIC, YIELDING, OFF, REST = 0, 1, -1, 2


def constants(scene, **values):
    """Return the constants of one lane, shape (1,), with the scene's defaults for missing values."""
    parameters = {name: jnp.full(1, values.pop(name, q.default)) for name, q in scene.parameters().items()}
    assert not values
    return scene.constants(parameters)


class Motion:
    """A lane from rest over `duration` [s], with its constants `p` and its steps, one per row.

    `growth` is the change of x4 in each step. `x3` and `x4` are the values at the end of each step, relative to the
    start of the run. `rock` is the mode.
    """

    def __init__(self, duration, shape="rectangular", scene=None, start=None, method=None, settings=None, **values):
        scene = scene or Penetration(shape)
        p = constants(scene, **values)
        settings = Accuracy(*map(jnp.asarray, FINE._replace(**(settings or {}))))
        self.steps = record(scene, method or Located(), p, scene.start(p, start, (1,)), settings, float(duration))[0]
        self.scene = scene
        self.p = {name: float(np.ravel(value)[0]) for name, value in Flat(p).items()}
        self.constants = jax.tree.map(lambda value: jnp.ravel(jnp.asarray(value))[0], p)
        self.index = {name: i for i, name in enumerate(scene.state_names)}
        self.rock = self.steps.mode[:, scene.mode_place("rock")]
        self.times = self.steps.start + self.steps.dt
        self.growth = self._over_the_step("growth", lambda c, tau: polynomial.polyval(tau, c) - c[0])
        self.x4 = np.cumsum(self.growth)
        self.x3 = self.x4 + self.after("compression")

    def after(self, name):
        """Return a state at the end of each step."""
        return self.steps.after[:, self.index[name]]

    def integral(self, name):
        """Return the integral of a state over time in each step."""
        integrals = self._over_the_step(name, lambda c, tau: polynomial.polyval(tau, polynomial.polyint(c)))
        return integrals * self.steps.h

    def resistance(self):
        """Return the integral of N over time [N s] in each step (6.2): k3 e while elastic, D while yielding."""
        elastic = self.p["k3"] * self.integral("compression")
        yielding = self.p["threshold"] * self.steps.dt
        return np.where(self.rock == ELASTIC, elastic, np.where(self.rock == YIELDING, yielding, 0.0))

    def at(self, times):
        """Return the states by name at `times` [s]."""
        states, _, _ = sample(self.steps, times)
        return {name: states[i] for name, i in self.index.items()}

    def pulses(self):
        """Return the indices of the steps at whose end a pulse begins."""
        hit = self.steps.hits[:, self.scene.event_names.index("pulse")]
        return np.flatnonzero(hit & (self.steps.mode[:, self.scene.mode_place("pushing")] == 0))

    def _over_the_step(self, name, evaluate):
        with np.errstate(invalid="ignore", divide="ignore"):
            tau = np.where(self.steps.dt > 0, self.steps.dt / self.steps.h, 0.0)
        rows = self.steps.polynomials[:, self.index[name]]
        return np.array([evaluate(c, t) for c, t in zip(rows, tau, strict=True)])
