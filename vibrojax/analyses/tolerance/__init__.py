"""The analysis `tolerance`: the behaviour of a machine whose parameters vary within tolerances."""
