"""Simulation of self-exciting percussive-rotary drilling over large parameter spaces.

    import vibrojax as vj
    ds = vj.run_sweep("regime-map")

Public names are imported on first use, so that importing the package is fast and changes no global settings. Editors
and type checkers read the names from `__init__.pyi`.
"""

from importlib import import_module

_HOMES = {
    "run_sweep": "vibrojax.analyses.sweep.run",
    "read_sweep": "vibrojax.sweep.input.read",
    "orbits": "vibrojax.analyses.orbits.analysis",
    "follow": "vibrojax.analyses.continuation.run",
    "borders": "vibrojax.analyses.borders.run",
    "attractors": "vibrojax.analyses.attractors.run",
    "explore": "vibrojax.explorer.write",
    "smallest_push": "vibrojax.analyses.push.run",
    "tolerance": "vibrojax.analyses.tolerance.run",
    "simulate": "vibrojax.sweep.simulation",
    "fit_rop": "vibrojax.analyses.rop_law",
    "fit_joint": "vibrojax.analyses.rop_law",
    "fit_friction": "vibrojax.analyses.rop_law",
    "refit_frequency": "vibrojax.analyses.rop_law",
    "derivatives": "vibrojax.analyses.sensitivity.run",
    "run_accuracy": "vibrojax.analyses.accuracy",
    "run_reproduction": "vibrojax.reproduce",
    "write_reproduction": "vibrojax.reproduce",
    "open_dataset": "vibrojax.io.dataset",
    "write_dataset": "vibrojax.io.dataset",
    "analyse": "vibrojax.analyses.registry",
    "Analysis": "vibrojax.analyses.analysis",
    "SummaryPart": "vibrojax.analyses.analysis",
    "PictureRule": "vibrojax.analyses.analysis",
    "SweepAnalysis": "vibrojax.analyses.orbits.analysis",
    "picture": "vibrojax.analyses.pictures",
    "save_picture": "vibrojax.analyses.pictures",
    "write_page": "vibrojax.explorer",
    "Variable": "vibrojax.io.variables",
    "InputError": "vibrojax.errors",
    "UnusualValue": "vibrojax.sweep.input.values",
    "list_scenes": "vibrojax.analyses.catalogue",
    "list_parameters": "vibrojax.analyses.catalogue",
    "list_variables": "vibrojax.analyses.catalogue",
    "list_settings": "vibrojax.analyses.catalogue",
    "FRICTION_LAWS": "vibrojax.models.physics.friction",
    "SCENES": "vibrojax.models.scenes",
    "contact": "vibrojax.models.physics",
    "friction": "vibrojax.models.physics",
    "modes": "vibrojax.models.physics",
    # Tools for user-defined physics
    "elementary": "vibrojax.models.physics",
    "parameters": "vibrojax.models.physics",
    "FrictionLaw": "vibrojax.models.physics.friction",
    "Scene": "vibrojax.models.scenes",
    "State": "vibrojax.models.scenes",
    "Mode": "vibrojax.models.scenes",
    "Marker": "vibrojax.models.scenes",
    "Guard": "vibrojax.models.scenes",
    "Section": "vibrojax.models.scenes",
    "Swing": "vibrojax.models.scenes",
    "HasFriction": "vibrojax.models.scenes",
    "HasContact": "vibrojax.models.scenes",
    "HasRock": "vibrojax.models.scenes",
    "Driven": "vibrojax.models.scenes",
    "Gauge": "vibrojax.measures",
    "Stepper": "vibrojax.stepping",
    "Located": "vibrojax.stepping",
    "Smoothed": "vibrojax.stepping",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    if name == "__version__":
        value: object = import_module("vibrojax.io.provenance").package_version()
    elif name in _HOMES:
        home = import_module(_HOMES[name])
        value = getattr(home, name) if hasattr(home, name) else import_module(f"{_HOMES[name]}.{name}")
    else:
        raise AttributeError(f"module 'vibrojax' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
