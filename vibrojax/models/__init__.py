"""The equations of the machines: physics and scenes."""
