"""Speed against error: run time and error of every method, measured on this computer."""
