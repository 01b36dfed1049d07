"""Hidden-effect trials: what is hidden, how it is recorded, what is right, and what came of it."""
