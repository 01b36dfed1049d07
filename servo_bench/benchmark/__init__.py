"""Every speed or accuracy claim of the bench, measured, with its reference beside it."""
