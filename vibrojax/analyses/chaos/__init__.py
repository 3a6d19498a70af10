"""Largest Lyapunov exponents across all events, and the classification of lanes (periodic, chaotic, ...) by them."""
