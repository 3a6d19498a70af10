"""The analysis `derivatives`: derivatives of features with respect to parameters."""

from vibrojax.analyses.analysis import Analysis


class Derivatives(Analysis):
    """Derivatives of the features of a lane with respect to the parameters of the scene."""

    kind = "derivatives"
