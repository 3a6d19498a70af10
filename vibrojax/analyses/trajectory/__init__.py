"""Pictures of single trajectories."""
