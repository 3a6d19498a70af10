"""The best drill under constraints that hold from every start and everywhere within the tolerances."""
