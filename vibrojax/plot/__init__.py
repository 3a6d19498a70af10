"""Pictures of datasets: regimes, bifurcations, rates of penetration, their law, and trajectories."""

from vibrojax.plot._accuracy import work_precision as work_precision
from vibrojax.plot._bifurcation import bifurcation as bifurcation
from vibrojax.plot._flags import REGIME_COLOURS as REGIME_COLOURS
from vibrojax.plot._law import fitted_law as fitted_law
from vibrojax.plot._pulses import pulses as pulses
from vibrojax.plot._rate_map import rate_map as rate_map
from vibrojax.plot._rates import rates as rates
from vibrojax.plot._regimes import regime_map as regime_map
from vibrojax.plot._response import response as response
from vibrojax.plot._save import picture as picture
from vibrojax.plot._save import save_picture as save_picture
from vibrojax.plot._trajectory import trajectory as trajectory
