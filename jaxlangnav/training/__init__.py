"""Training and evaluation of the log-linear correspondence models (section 4.1)."""

from jaxlangnav.training.fit import Fit, TrainingConfig, train_graph

__all__ = ["Fit", "TrainingConfig", "train_graph"]
