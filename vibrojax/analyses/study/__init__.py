"""The analysis `study`: effects and interactions of parameters, by Sobol indices and a two-level factorial design."""
