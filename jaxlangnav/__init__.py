"""jaxlangnav: language-guided navigation in unknown places, on JAX."""
