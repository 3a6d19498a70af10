"""Laws fitted to rig measurements and to the results of sweeps."""
