"""Pictures of datasets: regimes, bifurcations, rates of penetration, their law, and trajectories."""

from vibrojax.plot._bifurcation import bifurcation as bifurcation
from vibrojax.plot._colours import REGIME_COLOURS as REGIME_COLOURS
from vibrojax.plot._hole import pulses as pulses
from vibrojax.plot._hole import response as response
from vibrojax.plot._pictures import fitted_law as fitted_law
from vibrojax.plot._pictures import picture as picture
from vibrojax.plot._pictures import rate_map as rate_map
from vibrojax.plot._pictures import regime_map as regime_map
from vibrojax.plot._pictures import save_picture as save_picture
from vibrojax.plot._rates import rates as rates
from vibrojax.plot._time_history import trajectory as trajectory
from vibrojax.plot._work_precision import work_precision as work_precision
