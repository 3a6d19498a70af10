"""Physics and scenes: the equations of the machines."""
