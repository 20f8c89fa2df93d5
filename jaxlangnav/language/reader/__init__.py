"""The reader: free speech put into the controlled language by a trained sequence model (ours)."""
