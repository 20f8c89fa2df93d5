"""Strings end here: phrase trees, lexicon, grammar, parser and corpus (section 3.1)."""
