"""Training and evaluation of the log-linear correspondence models (section 4.1)."""

from jaxlangnav.training.fit import TrainingConfig as TrainingConfig, train_graph as train_graph
