"""The analysis `rig`: what drilling engineers look at in a rig log."""
