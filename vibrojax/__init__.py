"""Self-exciting percussive-rotary drilling, over whole parameter spaces.

    import vibrojax as vj
    ds = vj.run_sweep("regime-map")

Names are imported when they are first used, so that importing the package costs nothing and sets nothing. Editors and
type checkers read them in `__init__.pyi`.
"""

from importlib import import_module

_HOMES = {
    "run_sweep": "vibrojax.sweep",
    "read_sweep": "vibrojax.input.read",
    "orbits": "vibrojax.found_orbits",
    "follow": "vibrojax.followed",
    "borders": "vibrojax.found_borders",
    "attractors": "vibrojax.found_attractors",
    "explore": "vibrojax.explorer.widget",
    "smallest_push": "vibrojax.pushed",
    "simulate": "vibrojax.simulation",
    "fit_rop": "vibrojax.laws",
    "fit_joint": "vibrojax.laws",
    "fit_friction": "vibrojax.laws",
    "refit_frequency": "vibrojax.laws",
    "derivatives": "vibrojax.sensitivity",
    "run_accuracy": "vibrojax.accuracy",
    "run_reproduction": "vibrojax.reproduce",
    "write_reproduction": "vibrojax.reproduce",
    "open_dataset": "vibrojax.store.dataset",
    "write_dataset": "vibrojax.store.dataset",
    "picture": "vibrojax.plot",
    "save_picture": "vibrojax.plot",
    "write_page": "vibrojax.explorer",
    "InputError": "vibrojax.errors",
    "UnusualValue": "vibrojax.input.plausible",
    "list_scenes": "vibrojax.reference",
    "list_parameters": "vibrojax.reference",
    "list_variables": "vibrojax.reference",
    "list_settings": "vibrojax.reference",
    "FRICTION_LAWS": "vibrojax.physics.friction",
    "SCENES": "vibrojax.scenes",
    "contact": "vibrojax.physics",
    "friction": "vibrojax.physics",
    "modes": "vibrojax.physics",
    # What physics of one's own is written with.
    "elementary": "vibrojax.physics",
    "parameters": "vibrojax.physics",
    "FrictionLaw": "vibrojax.physics.friction",
    "Scene": "vibrojax.scenes",
    "State": "vibrojax.scenes",
    "Mode": "vibrojax.scenes",
    "Marker": "vibrojax.scenes",
    "Guard": "vibrojax.scenes",
    "Section": "vibrojax.scenes",
    "Swing": "vibrojax.scenes",
    "HasFriction": "vibrojax.scenes",
    "HasContact": "vibrojax.scenes",
    "HasRock": "vibrojax.scenes",
    "Driven": "vibrojax.scenes",
    "Gauge": "vibrojax.measure",
    "Stepper": "vibrojax.stepping",
    "Located": "vibrojax.stepping",
    "Smoothed": "vibrojax.stepping",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    if name == "__version__":
        value: object = import_module("vibrojax.store.provenance").package_version()
    elif name in _HOMES:
        home = import_module(_HOMES[name])
        value = getattr(home, name) if hasattr(home, name) else import_module(f"{_HOMES[name]}.{name}")
    else:
        raise AttributeError(f"module 'vibrojax' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
