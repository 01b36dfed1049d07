"""Estimators of a response: each is fitted to a training and predicts input it never saw."""
