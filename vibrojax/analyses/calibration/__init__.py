"""The analysis `calibration`: parameters of the drill from observations, by gradients through periodic orbits."""
