"""Files: written whole, read with limits, and trusted only where they are one's own."""
