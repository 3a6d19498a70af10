"""The law fitted in every form to every group of lanes, in one program."""

import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from os import PathLike

import jax
import numpy as np
import xarray as xr

from vibrojax.devices import precision
from vibrojax.errors import shown, suggestion
from vibrojax.laws._about import described, law_title, provenance
from vibrojax.laws._forms import FORMS
from vibrojax.laws._group import fit_group
from vibrojax.laws._lanes import Lanes, lanes_of, read_data, usable
from vibrojax.laws._robust import LOSSES

_MOST_GROUPS, _FEWEST_LANES, _BLOCK = 64, 32, 2**16
"""Of a block: groups, lanes of each, and all lanes together."""

_ABOUT = {
    "C": ("m s-1", "coefficient of the rate-of-penetration law"),
    "C_stderr": ("m s-1", "standard error of C"),
    "eta0": ("1", "relief at the onset"),
    "eta0_stderr": ("1", "standard error of eta0"),
    "exponent": ("1", "exponent of the relief"),
    "exponent_stderr": ("1", "standard error of the exponent"),
    "r_squared": ("1", "share of the rate's variance that the form explains"),
    "aic": ("1", "n ln(RSS/n) + 2k, RSS in m2 s-2"),
    "degrees_of_freedom": ("1", "lanes with a residual less coefficients"),
    "used": ("1", "lanes that the fit used, those at zero rate among them"),
    "left_out": ("1", "lanes left out: failed, irregular, or without usable values"),
    "reason": ("1", "why a coefficient is not a number"),
}


def fit_rop(
    data: xr.Dataset | str | PathLike,
    along: str | None = None,
    by: Sequence[str] = (),
    robust: str | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """The rate-of-penetration law, eq. 6.4, in the readings of R9 and beside two rivals, fitted to each group of lanes.

    Least squares of the rate. A lane at zero rate is censored: it counts only where a form predicts a rate above zero.
    Lanes that failed or are irregular, or have no usable values, are left out and counted. Standard errors follow from
    the Jacobian and each lane's own residual, so that they hold for noise of one size and for noise in proportion.

    **Arguments:**

    - `data`: a dataset with rate_of_penetration [m/s] and relief [1], and perhaps regime; or the path of such a .nc,
      or of a CSV with columns rate_of_penetration, and relief or mean_force and threshold [N].
    - `along`: the axis to fit along; by default frequency, else v, else the rows. One fit per point of the others.
    - `by`: of a table (a CSV, or a sweep of points), the columns whose values tell the groups apart; all but `along`
      and mean_force where `along` is a column itself.
    - `robust`: "soft-l1" or "huber", for data with outliers; the scale comes from the median absolute deviation. R² and
      AIC stay those of plain residuals.
    - `progress`: say on stderr what was fitted.

    **Returns:** a dataset over the groups and `form` (contract: fit dataset): coefficients with their standard errors,
    goodness, and `reason`; NaN where a form has no such coefficient or the lanes cannot tell it.

    **Raises:** `InputError`.
    """
    place, data = read_data(data, "fit_rop")
    if robust is not None and robust not in LOSSES:
        raise place.at("robust").error(f"{shown(robust)} is unknown; {suggestion(str(robust), LOSSES)}")
    lanes = lanes_of(place, usable(data), along, (by,) if isinstance(by, str) else tuple(by))
    start = time.monotonic()
    found = _fitted(lanes, robust)
    if progress:
        size, took = lanes.count.max(), time.monotonic() - start
        print(f"{lanes.count.size} groups of {size} lanes along {lanes.along} fitted in {took:.1f} s", file=sys.stderr)
    dims = (*lanes.sizes, "form")
    shape = (*lanes.sizes.values(), len(FORMS))
    attributes = described(_ABOUT)
    variables = {name: (dims, found[name].reshape(shape), about) for name, about in attributes.items()}
    form = ("form", [form.name for form in FORMS], {"units": "1", "long_name": "form of the law"})
    more = {"along": lanes.along, "formulas": "; ".join(f"{form.name}: {form.formula}" for form in FORMS)}
    more |= {"robust": robust} if robust else {}
    return xr.Dataset(
        variables, lanes.coordinates | {"form": form}, provenance(place, data, "fit", law_title(place, data), more)
    )


@partial(jax.jit, static_argnames="robust")
def _program(relief, rate, valid, robust):
    """All forms over the groups of a block; by form, arrays (groups,)."""
    return [jax.vmap(partial(fit_group, form, robust=robust))(relief, rate, valid) for form in FORMS]


def _fitted(lanes: Lanes, robust: str | None) -> dict[str, np.ndarray]:
    """By variable, (groups, forms)."""
    with precision("float64"):
        found = [jax.device_get(_program(*block, robust)) for block in _blocks(lanes)]
    stacked = {
        name: np.concatenate([np.stack([form[name] for form in block], axis=-1) for block in found])[: len(lanes.rate)]
        for name in found[0][0]
    }
    counts = ("used", "degrees_of_freedom")
    stacked |= {name: stacked[name].astype(np.int32) for name in counts}
    stacked["left_out"] = (lanes.count[:, None] - stacked["used"]).astype(np.int32)
    return stacked | {"reason": stacked["reason"].astype(np.int8)}


def _blocks(lanes: Lanes) -> Iterator[list[np.ndarray]]:
    """Relief, rate and valid of some groups at a time, filled up with what is not valid.

    Blocks are of one shape, lanes of a power of two: data of about one size share a program, and memory is bounded.
    """
    groups, longest = lanes.rate.shape
    width = max(_FEWEST_LANES, 1 << (longest - 1).bit_length())
    height = min(_MOST_GROUPS, max(1, _BLOCK // width))
    for first in range(0, groups, height):
        block = [x[first : first + height] for x in (lanes.relief, lanes.rate, lanes.valid)]
        yield [np.pad(x, [(0, height - len(x)), (0, width - longest)]) for x in block]
