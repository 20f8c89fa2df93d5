"""Speed: what ``jaxlangnav bench`` measures, and the plain twins that it is compared with."""
