"""The smallest push in each state that makes a machine leave its attractor."""
