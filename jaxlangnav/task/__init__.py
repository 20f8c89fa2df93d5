"""Tasks: a sentence followed in a simulated world, and the evaluation of its success."""
