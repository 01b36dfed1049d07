"""The run: a bus loop in a process of its own, and the session that watches it and records."""
