"""The data that a law was fitted to, as the fit's dataset carries them: relief, rate, and what became of each lane."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from vibrojax.analyses.rop_law.groups import Groups
from vibrojax.analyses.rop_law.results import with_attributes
from vibrojax.io.variables import Variable

LANE = "lane"
"""The dimension of a group's lanes."""

NO_LANE, FITTED, CENSORED, LEFT_OUT = range(4)

_VARIABLES = {
    "data_relief": Variable("1", "relief of the lanes that were fitted"),
    "data_rate_of_penetration": Variable("m s-1", "rate of penetration of the lanes that were fitted"),
    "data_use": Variable("1", "what became of a lane", np.int8, ("no-lane", "fitted", "censored", "left-out")),
}


def fitted_data(groups: Groups) -> dict[str, xr.Variable]:
    """The lanes of `groups` along the groups' dimensions and `lane`; NaN and no-lane where a group has fewer.

    Lanes at zero rate are censored; left out are those that failed, are irregular or have no usable values.
    """
    lane = np.arange(groups.rate.shape[1]) < groups.count[:, None]
    use = np.select(
        [~lane, groups.valid & (groups.rate > 0), groups.valid], [NO_LANE, FITTED, CENSORED], default=LEFT_OUT
    )
    values = {
        "data_relief": np.where(lane, groups.relief, np.nan),
        "data_rate_of_penetration": np.where(lane, groups.rate, np.nan),
        "data_use": use,
    }
    shape = (*groups.sizes.values(), groups.rate.shape[1])
    dims: Sequence[str] = (*groups.sizes, LANE)
    shaped = {name: value.reshape(shape) for name, value in values.items()}
    return with_attributes(_VARIABLES, shaped, dict.fromkeys(_VARIABLES, dims))
