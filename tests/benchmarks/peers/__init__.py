"""Other methods for the same lanes, each tuned as well as its kind allows."""
