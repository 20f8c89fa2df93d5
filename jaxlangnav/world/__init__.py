"""The simulated world (section 4.2): ground truth lives only here."""
