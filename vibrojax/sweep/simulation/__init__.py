"""Simulation of one point of a scene: its trajectory as a dataset."""

from vibrojax.sweep.simulation.dense_output import Record as Record
from vibrojax.sweep.simulation.dense_output import record as record
from vibrojax.sweep.simulation.run import simulate as simulate
from vibrojax.sweep.simulation.run import simulate_point as simulate_point
