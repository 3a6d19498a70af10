"""What a user may write: names, values, sweep files."""
