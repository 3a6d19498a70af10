"""One point of a scene in time: its trajectory as a dataset."""

from vibrojax.simulation._simulate import simulate as simulate
