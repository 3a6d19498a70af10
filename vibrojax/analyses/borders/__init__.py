"""The borders of the stable single impact in planes of two parameters, as curves with names."""
