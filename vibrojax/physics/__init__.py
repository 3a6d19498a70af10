"""Physics in plain JAX: friction laws, contact, rock, pulses, linear modes, parameters and units."""
