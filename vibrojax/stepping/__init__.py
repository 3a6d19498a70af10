"""Two ways to step many lanes at once, behind one interface: `method.step(scene, p, lane, ..., moving, marked)`."""

from vibrojax.stepping._keep import keep as keep
from vibrojax.stepping._step import Clock as Clock
from vibrojax.stepping._step import Lane as Lane
from vibrojax.stepping._step import Step as Step
from vibrojax.stepping._step import lane_at as lane_at
from vibrojax.stepping.located import Located as Located
from vibrojax.stepping.smoothed import Smoothed as Smoothed
