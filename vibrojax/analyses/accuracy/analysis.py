"""The analysis `accuracy`: the picture of a study of speed against error."""

from vibrojax.analyses.accuracy.picture import work_precision
from vibrojax.analyses.analysis import Analysis, PictureRule


class AccuracyStudy(Analysis):
    """Study of speed against error on this machine: a dataset, a table and a picture."""

    kind = "accuracy"
    view = "none"
    no_view = "holds speed against error, over no axes; vibrojax plot draws it"
    pictures = (PictureRule("accuracy", lambda held: True, work_precision),)
