"""The best drill under constraints that hold from every start and at samples of the tolerances."""
