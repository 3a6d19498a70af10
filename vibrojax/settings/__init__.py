"""Input of users: names, values, sweep files."""
