"""Other ways to compute the same lanes, each as good as its kind can be made."""
