"""A counter box on a pty: the load's encoder beside the drive's wire."""
