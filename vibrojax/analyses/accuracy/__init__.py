"""Speed against error: run time and error of every method, measured on this computer."""

from vibrojax.analyses.accuracy.study import pareto as pareto
from vibrojax.analyses.accuracy.study import run_accuracy as run_accuracy
from vibrojax.analyses.accuracy.study import table as table
