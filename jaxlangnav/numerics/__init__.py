"""Numerics without robot terms: small Gaussians, sampling from log-weights, resampling, L-BFGS."""
