"""Pictures and summaries of single trajectories."""
