"""Hostile or malformed datasets: attributes, coordinates and texts that no command of the package writes."""

import json
from collections.abc import Callable

import numpy as np
import xarray as xr

Change = Callable[[xr.Dataset], xr.Dataset]

CODE = 'v=1.5, **(__import__("os").system("touch hacked") or {})'
"""A parameter name that runs a command if it is pasted into a Python call."""

MARKUP = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 1'>"
STEERING = "a\x1b]0;title\x07\x9b31m\u202e$\\frac{$\nb"
HUGE = "A" * 5_000_000


def attribute(name: str, value: object) -> Change:
    """Return a change that sets an attribute."""
    return lambda ds: ds.assign_attrs({name: value})


def differing(**changes: object) -> Change:
    """Return a change that records one parameter as different from its default."""
    record = {"name": "v", "symbol": "v", "units": "m s-1", "value": 1.0, "default": 1.5}
    return attribute("differing", json.dumps([record | changes]))


def run(**changes: object) -> Change:
    """Return a change of the attribute `run`."""
    return lambda ds: ds.assign_attrs(run=json.dumps(json.loads(ds.attrs["run"]) | changes))


def regimes(value: object, dtype: object) -> Change:
    """Return a change that gives all lanes one regime."""
    return lambda ds: ds.assign(regime=ds["regime"].copy(data=np.full(ds["regime"].shape, value, dtype)))


def each_variable(**attributes: object) -> Change:
    """Return a change of the attributes of all variables."""

    def change(ds: xr.Dataset) -> xr.Dataset:
        ds = ds.copy()
        for name in ds.variables:
            ds[name].attrs.update(attributes)
        return ds

    return change


REFUSED: dict[str, tuple[Change, str]] = {
    "run is not JSON": (attribute("run", "{not json"), "attribute run"),
    "run is deeply nested": (attribute("run", "[" * 100_000), "attribute run"),
    "settle is a text": (run(settle="forty"), "attribute run: settle"),
    "settle is infinite": (attribute("run", '{"settle": 1e999, "observe": 8.0}'), "attribute run: settle"),
    "differing names code": (differing(name=CODE), "attribute differing[0]: name"),
    "differing has a number of 400 digits": (differing(value=10**400), "attribute differing[0]: value"),
    "a parameter is true": (attribute("parameters", '{"v": true}'), "attribute parameters"),
    "certified is a list": (attribute("certified", "[1, 2]"), "attribute certified"),
    "the scene is a number": (attribute("scene", 3), "attribute scene"),
    "an infinite coordinate": (lambda ds: ds.assign_coords(gamma=ds["gamma"] + np.inf), "coordinate gamma"),
    "regimes are texts": (regimes("text", "U4"), "variable regime"),
    "a regime that has no meaning": (regimes(99, np.int8), "99 is none of its flags"),
    "a name with a direction mark": (lambda ds: ds.rename(period="per\u202eiod"), "variable"),
}
"""Malformed datasets, each with a part of the error message."""

SHOWN: dict[str, Change] = {
    "texts that steer": lambda ds: each_variable(long_name=MARKUP, units=MARKUP, symbol=MARKUP)(
        ds.assign_attrs(history=HUGE, title=f"{STEERING} {MARKUP}", scene=MARKUP, friction=MARKUP, start=MARKUP)
    ),
    "a variable called __proto__": lambda ds: ds.rename(period="__proto__"),
    "no attributes": lambda ds: ds.drop_attrs(),
    "nothing but NaN": lambda ds: ds.assign({name: ds[name] * np.nan for name in ds.data_vars if ds[name].ndim}),
    "no lanes": lambda ds: ds.isel(gamma=slice(0, 1)).drop_vars("gamma"),
}
"""Unusual datasets, each of which is shown or refused."""
