"""Subcommands of ``jaxlangnav``; their modules are imported when called.

A command is a dataclass of its options; its docstring is its help text. ``run`` computes and
returns the document that ``--json`` prints; what people read goes through an ``Output``.
"""

SUMMARIES = {
    "follow": "Follow a sentence in a world never seen, until the robot says stop.",
    "serve": "Open a page on this machine: type, watch the robot search, say more.",
    "parse": "Show the phrases of a sentence.",
    "ground": "Show what a sentence is taken to mean, with probabilities.",
    "train": "Train a model of language from labelled sentences.",
    "evaluate": "Measure how often sentences are understood: Table 1.",
    "reproduce": "Run an experiment of the paper and set it beside the printed numbers.",
    "sweep": "Run any grid of worlds, commands, ranges and policies; resumable.",
    "summarize": "Print the tables of a sweep, with intervals and paired tests.",
    "bench": "Measure speed, as ratios against baselines in the same run.",
}
"""One-line summary of each command in ``jaxlangnav --help``."""
MODULES = {"parse": "ground", "evaluate": "train", "summarize": "sweep"}
"""Module of each command that is not named after its module."""
