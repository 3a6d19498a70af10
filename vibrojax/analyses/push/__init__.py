"""The smallest push (sudden change) in each state variable after which a machine leaves its attractor."""
