"""Chosen numbers of a model, fitted to a recording: `fit(recording, model, free) -> Fit`.

free                          which numbers those may be, their bounds and usual ranges
starting, solver, sharpening  where a search starts, its steps, its Jacobian
uncertainty                   standard errors and correlations, and what they mean in words
driven, twist, foreign_*      recordings of other benches: driven by a current or voltage, or a load
                              behind a play, and where their searches start
model_file                    a model as a TOML file
"""
