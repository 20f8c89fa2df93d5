"""Atomic numerics without robot words: small Gaussians, log-domain draws, resampling."""
