"""The variables of datasets derived from a sweep's orbits: families, borders and attractors."""

import numpy as np

from vibrojax.io.variables import Variable
from vibrojax.measures.labels import REGIMES

SPECIAL_KINDS = ("fold", "period-doubling", "torus", "grazing", "stick", "section", "end")
"""Meanings of the flags of `special_kind`."""

BORDER_KINDS = (*SPECIAL_KINDS, "basin", "not-settled")
"""Meanings of the flags of `kind`: kinds of special points, and limits beyond which an initial condition no longer
leads to an existing orbit."""

OF_FAMILIES: dict[str, Variable] = {
    "branch": Variable("1", "branch of the family, 0 the one that it begins with", np.int32),
    "special_kind": Variable("1", "kind of the special point", np.int8, SPECIAL_KINDS),
    "special_value": Variable("of the parameter", "value of the parameter at the special point"),
    "special_branch": Variable("1", "branch of the special point", np.int32),
    "special_note": Variable("", "what there is to say", np.str_),
    "point_family": Variable("1", "number of the family", np.int32),
    "special_family": Variable("1", "number of the family", np.int32),
}
"""Variables in addition to those of orbits and measures; the last two exist only for several families."""

OF_BORDERS: dict[str, Variable] = {
    "curve": Variable("1", "number of the curve", np.int32),
    "kind": Variable("1", "what ends the region there", np.int8, BORDER_KINDS),
    "region_area": Variable("1", "share of the plane with a stable single impact"),
}

OF_ATTRACTORS: dict[str, Variable] = {
    "share": Variable("1", "share of the starts that end in the attractor"),
    "share_stderr": Variable("1", "standard error of share, binomial"),
    "unassigned": Variable("1", "starts of which no attractor could be told", np.int32),
    "lane_attractor": Variable("1", "number of the attractor that the lane ends in; -1: none could be told", np.int32),
    "named_attractor": Variable(
        "1", "number of the attractor that the start of this name leads to; -1: none", np.int32
    ),
    "named_regime": Variable("1", "regime that the start of this name leads to", np.int8, REGIMES),
}
