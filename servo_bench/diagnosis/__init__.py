"""What the rig's simulation gets wrong, and by how much.

fit          chosen numbers of a model fitted to a recording: `fit(recording, model, free) -> Fit`
free         which numbers those may be, their bounds and usual ranges
comparison   measured minus simulated, signal by signal, for any model
rows, playing, noise          times and holes; whole or in windows; floors of the sensors
starting, solver, sharpening  where a search starts, its steps, its Jacobian
uncertainty  standard errors and correlations, and what they mean in words
model_file   a model as a TOML file
signature    how an effect shows, computed
"""
