"""Speed against error: what every method costs for the error that it leaves, measured on this machine."""

from vibrojax.accuracy._front import pareto as pareto
from vibrojax.accuracy._study import run_accuracy as run_accuracy
from vibrojax.accuracy._table import table as table
