"""One point of a scene in time: its trajectory as a dataset."""

from vibrojax.simulation._record import Record as Record
from vibrojax.simulation._record import record as record
from vibrojax.simulation._simulate import simulate as simulate
