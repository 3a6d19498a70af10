"""Self-exciting percussive-rotary drilling, over whole parameter spaces.

    import vibrojax as vj
    ds = vj.run_sweep("regime-map")

Names are imported when they are first used, so that importing the package costs nothing and sets nothing.
"""

from importlib import import_module

_HOMES = {
    "run_sweep": "vibrojax.sweep",
    "read_sweep": "vibrojax.sweep",
    "simulate": "vibrojax.simulation",
    "fit_rop": "vibrojax.laws",
    "fit_joint": "vibrojax.laws",
    "fit_friction": "vibrojax.laws",
    "refit_frequency": "vibrojax.laws",
    "run_accuracy": "vibrojax.accuracy",
    "run_reproduction": "vibrojax.reproduce",
    "write_reproduction": "vibrojax.reproduce",
    "rop_derivatives": "vibrojax.laws",
    "open_dataset": "vibrojax.store.dataset",
    "write_dataset": "vibrojax.store.dataset",
    "picture": "vibrojax.plot",
    "save_picture": "vibrojax.plot",
    "InputError": "vibrojax.errors",
    "FRICTION_LAWS": "vibrojax.physics.friction",
    "SCENES": "vibrojax.scenes",
    "contact": "vibrojax.physics",
    "friction": "vibrojax.physics",
    "modes": "vibrojax.physics",
}

__all__ = list(_HOMES)


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module 'vibrojax' has no attribute {name!r}")
    home = import_module(_HOMES[name])
    found = getattr(home, name) if hasattr(home, name) else import_module(f"{_HOMES[name]}.{name}")
    globals()[name] = found
    return found


def __dir__():
    return sorted(__all__)
