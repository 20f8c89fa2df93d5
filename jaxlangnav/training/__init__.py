"""Training of the log-linear factors, and how good they are (section 4.1)."""

from jaxlangnav.training.fit import Fit, TrainingConfig, train_graph

__all__ = ["Fit", "TrainingConfig", "train_graph"]
