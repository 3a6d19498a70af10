"""The analysis `derivatives`: derivatives of features with respect to parameters."""

from vibrojax.analyses.analysis import Analysis


class Derivatives(Analysis):
    """Differentiate the features of one lane with respect to the parameters of its scene."""

    kind = "derivatives"
