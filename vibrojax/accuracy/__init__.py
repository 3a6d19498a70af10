"""Speed against error: what every method costs for the error that it leaves, measured on this computer."""

from vibrojax.accuracy._report import pareto as pareto
from vibrojax.accuracy._report import table as table
from vibrojax.accuracy._study import run_accuracy as run_accuracy
