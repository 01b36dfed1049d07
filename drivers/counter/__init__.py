"""A counter box on a serial line of its own: the load's encoder beside any drive."""
