"""The pictures, in the source's axes, one file a group."""
